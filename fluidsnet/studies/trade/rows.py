"""Rows of the trade study: a point with its results over all simulations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, median
from typing import Any, final

from fluidsnet.studies.machine import BUSY
from fluidsnet.studies.trade.measure import Measured


@final
@dataclass(frozen=True)
class Row:
    """A point with its results.

    Attributes:
        label: Name of the point.
        kind: Its kind.
        advice: How to use it.
        interval: Time between two frames, s.
        measured: Results by simulation.
        failed: Why it failed, by simulation.
        training: Wall time of its training, s; NaN where unknown, 0 where there is none.
    """

    label: str
    kind: str
    advice: str
    interval: float
    measured: dict[str, Measured]
    failed: dict[str, str]
    training: float = 0.0

    @property
    def cpu(self) -> float:
        """Median over simulations of the time of all cores per simulated second."""
        return self._median([it.cpu / self.interval for it in self.measured.values()])

    @property
    def wall(self) -> float:
        """Median over simulations of the wall time per simulated second."""
        return self._median([it.wall / self.interval for it in self.measured.values()])

    @property
    def setup(self) -> float:
        """Median over simulations of the wall time before the first step, s."""
        return self._median([it.setup for it in self.measured.values()])

    @property
    def memory(self) -> float:
        """Most memory in any simulation, MB."""
        return max((it.memory for it in self.measured.values()), default=math.nan)

    @property
    def spoiled(self) -> bool:
        """Return True where others took part of a core meanwhile: its times are not trusted."""
        return self.kind != "trivial" and any(it.others > BUSY for it in self.measured.values())

    def values(self, result: str, frames: int) -> list[float]:
        """Return a result after some frames in each simulation that has it."""
        found = [it.values.get(result, {}).get(frames, math.nan) for it in self.measured.values()]
        return [value for value in found if not math.isnan(value)]

    def mean(self, result: str, frames: int) -> float:
        """Return the mean of a result over simulations, NaN where none has it.

        It is infinite where the point failed in a simulation.
        """
        values = self.values(result, frames)
        if self.failed and self.measured:
            return math.inf
        return fmean(values) if values else math.nan

    @staticmethod
    def _median(values: Sequence[float]) -> float:
        return median(values) if values else math.nan


def planes(rows: Sequence[Row], result: str, frames: int) -> dict[str, dict[str, Any]]:
    """Return cost and error of the points that have both, by kind and label.

    Points that err no less than a trivial predictor, which costs nothing, are left out.
    """
    found: dict[str, dict[str, Any]] = {}
    trivial = [row.mean(result, frames) for row in rows if row.kind == "trivial"]
    most = min((error for error in trivial if math.isfinite(error)), default=math.inf)
    for row in rows:
        error = row.mean(result, frames)
        if error < most and row.kind not in ("trivial", "floor"):
            found.setdefault(row.kind, {})[row.label] = (row.cpu, error)
    return found


def useless(rows: Sequence[Row], result: str, frames: int) -> list[str]:
    """Return the labels of the points that `planes` leaves out, though they have an error."""
    kept = {label for plane in planes(rows, result, frames).values() for label in plane}
    return [
        row.label
        for row in rows
        if row.kind not in ("trivial", "floor")
        and row.label not in kept
        and not math.isnan(row.mean(result, frames))
    ]


def floor(rows: Sequence[Row], result: str, frames: int) -> float:
    """Return the floor of chaos: the larger mean of its points; NaN where there is none."""
    means = [row.mean(result, frames) for row in rows if row.kind == "floor"]
    return max((it for it in means if math.isfinite(it)), default=math.nan)
