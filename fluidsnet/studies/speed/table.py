"""Results of the speed study as a table: a line for each method at each size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import nan
from statistics import median

import pandas as pd

from fluidsnet.studies.speed.options import Precision
from fluidsnet.studies.speed.trial import STAGES, Result


@dataclass
class Row:
    """One method at one size, or known frames predicted at once.

    Attributes:
        particles: Number of fluid particles.
        method: `network`, or the name of the solver.
        neighbors: Neighbor search of the network.
        precision: Precision of the network.
        compiled: Whether the network runs through torch.compile.
        time_step: Simulated time of a step, s.
        result: Outcome of the measurement.
        others: Cores that other processes kept busy meanwhile.
        frames: Number of frames predicted at once; 0 for a single step.
        solver: Time of a frame of the solver beside many frames at once, s.
    """

    particles: int
    method: str
    neighbors: str = ""
    precision: Precision = "float32"
    compiled: bool = False
    time_step: float = 0.02
    result: Result = field(default_factory=Result)
    others: float = 0.0
    frames: int = 0
    solver: float | None = None

    @property
    def label(self) -> str:
        """Name of the method with its settings, the same at all sizes."""
        if self.method != "network":
            return self.method
        if self.frames:
            return f"{self.frames} frames at once"
        compiled = ["torch.compile"] if self.compiled else []
        return ", ".join([self.neighbors, self.precision, *compiled])

    @property
    def name(self) -> str:
        """Name of the measurement in messages."""
        return f"{self.particles:,} particles, {self.label}"

    def columns(self) -> dict[str, object]:
        """Return the cells of the row by the names of ``speed.csv``."""
        result = self.result
        step = median(result.step) if result.step else nan
        # Input, target, integrator and walls are part of no stage.
        rest = max(0.0, step - sum(result.stages.values())) if result.stages else nan
        return {
            "fluid particles": self.particles,
            "wall particles": result.solids,
            "method": self.method,
            "neighbors": self.neighbors,
            "precision": self.precision if self.method == "network" else "",
            "torch.compile": self.compiled if self.method == "network" else "",
            "time step s": self.time_step,
            **_spread("step", result.step),
            **_spread("search alone", result.search),
            "s per simulated s": step / self.time_step,
            "particles per s": self.particles / step,
            "peak bytes": result.peak,
            "error": result.error,
            "speed-up": nan,
            **{f"{stage} s": result.stages.get(stage, nan) for stage in STAGES},
            "rest s": rest,
            "neighbors per particle": result.edges,
            "others' cores": round(self.others, 2),
            "note": result.failure,
        }


def speed_table(rows: Sequence[Row]) -> pd.DataFrame:
    """Return a line for each row; an empty cell is NaN. The speed-up is over IISPH."""
    table = pd.DataFrame([row.columns() for row in rows])
    table = table.astype({"peak bytes": "Int64", "error": float, "neighbors per particle": float})
    table["speed-up"] = speed_up(table, "IISPH")
    return table


def speed_up(
    table: pd.DataFrame, reference: str, by: str = "method", seconds: str = "s per simulated s"
) -> pd.Series[float]:
    """Return how many times as fast each line is as a reference line of the same size.

    Args:
        table: As of `speed_table`.
        reference: Cell of the reference lines in the column `by`.
        by: Column that names what is compared.
        seconds: Column of the times.
    """
    times = table[table[by] == reference].groupby("fluid particles")[seconds].first()
    return table["fluid particles"].map(times) / table[seconds]


def number(value: float | None, form: str = ".3g") -> str:
    """Format a number, by default with three digits or all before the point; – for none."""
    if value is None or pd.isna(value):
        return "–"
    text = f"{value:{form}}"
    # Numbers that are rounded up to 1,000 would get an exponent, too.
    return f"{value:,.0f}" if form == ".3g" and abs(float(text)) >= 1000 else text


def _spread(name: str, seconds: Sequence[float]) -> dict[str, object]:
    values = (median(seconds), min(seconds), max(seconds)) if seconds else (nan, nan, nan)
    return dict(zip((f"{name} s", f"{name} least s", f"{name} most s"), values, strict=True))
