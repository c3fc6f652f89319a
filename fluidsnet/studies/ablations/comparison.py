"""Comparison of each twin with its model, seed by seed, and verdicts on the paper's claims."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
from scipy.stats import t as student

from fluidsnet.studies.ablations.results import (
    ACCELERATION,
    ENERGY,
    MODEL,
    MOTION,
    MSE,
    ONE_STEP,
    REST,
    WITHOUT,
    Group,
)

#: Share of the truth's kinetic energy below which a velocity field counts as near 0.
NEAR_ZERO = 0.1
#: With fewer seeds nothing is decided.
_LEAST_SEEDS = 3
#: Metrics of rollouts from rest that are compared after the last step.
_ROLLOUT = ("position_error mm", "chamfer mm")
_DECISIONS = {1: "the model is better", -1: "the twin is better", 0: "not decided"}


@dataclass(frozen=True)
class Ratio:
    """Ratios of two numbers, one per seed.

    Attributes:
        each: Infinite where only the first number is, NaN where both are.
    """

    each: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Geometric mean; NaN where there is no ratio."""
        with np.errstate(all="ignore"):
            return float(np.exp(np.log(self.each).mean())) if self.each else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the mean, by Student's t over the logarithms.

        NaN with fewer than three seeds, and where a ratio is zero or not finite.
        """
        with np.errstate(all="ignore"):
            logs, count = np.log(self.each), len(self.each)
            if count < _LEAST_SEEDS or not np.isfinite(logs).all():
                return math.nan, math.nan
            half = student.ppf(0.975, count - 1) * logs.std(ddof=1) / math.sqrt(count)
            return float(np.exp(logs.mean() - half)), float(np.exp(logs.mean() + half))

    def side(self, value: float = 1.0) -> int:
        """Return 1 where the interval lies above a value, -1 below, 0 where undecided."""
        lower, upper = self.interval
        return int(lower > value) - int(upper < value)

    def __str__(self) -> str:
        if not self.each:
            return "unknown"
        lower, upper = map(digits, self.interval)
        if lower != "nan":
            return f"{digits(self.mean)} [{lower}, {upper}]"
        count = sum(not math.isfinite(ratio) for ratio in self.each)
        note = f" (not finite in {count} of {len(self.each)} seeds)" if count else ""
        return f"{digits(self.mean)}{note}"


def digits(value: float) -> str:
    """Format with three significant digits, trailing zeros kept, without an exponent."""
    if not math.isfinite(value):
        return f"{value:g}"
    text = f"{value:#.3g}"
    # Test the text, since 999.7 is rounded up to 1.00e+03.
    return f"{value:,.0f}" if float(text) >= 1000 else text.rstrip(".")


def paired(first: pd.Series[float], second: pd.Series[float]) -> Ratio:
    """Divide numbers by seed, for the seeds that have both."""
    first, second = first.align(second, join="inner")
    return Ratio(tuple((first / second).tolist()))


def compare(groups: Sequence[Group]) -> pd.DataFrame:
    """Return the ratios of each twin's metrics over the model's, one per row.

    A ratio above 1 means that the model is better.
    """
    rows = []
    for twin, group in product((ACCELERATION, WITHOUT), groups):
        figures = {"velocity_mse, one step": (MSE, ONE_STEP, 1)}
        for (steps, time), metric in product(group.moments(REST)[-1:], _ROLLOUT):
            figures[f"{metric.partition(' ')[0]}, {time:.4g} s"] = (metric, REST, steps)
        for figure, place in figures.items():
            ratio = paired(group.values(twin, *place), group.values(MODEL, *place))
            if ratio.each:
                each = " ".join(map(repr, ratio.each))
                rows.append((
                    twin, group.scene, group.stride, group.step, figure, len(ratio.each),
                    ratio.mean, *ratio.interval, each, _DECISIONS[ratio.side()],
                ))  # fmt: skip
    columns = [
        "twin", "scene", "stride", "step", "figure", "seeds", "twin / model", "from", "to",
        "each seed", "decided",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=columns)


def below_zero(group: Group, *predictors: str) -> bool:
    """Return whether the mean skills on the test split that were measured are below 0."""
    skills = [group.values(name, "skill") for name in predictors]
    means = [values.mean(skipna=False) for values in skills if len(values)]
    # The negation counts NaN as below 0.
    return bool(means) and not any(mean >= 0 for mean in means)


def accuracy(group: Group, twin: str) -> Ratio:
    """Divide the twin's `velocity_mse` by the model's, one step ahead on the test split."""
    return paired(group.values(twin, MSE), group.values(MODEL, MSE))


def energies(group: Group, steps: int) -> tuple[Ratio, Ratio, Ratio]:
    """Compare the kinetic energy of rollouts in motion after some steps.

    Returns:
        That without the global feature over the truth's; that with it over the truth's; that
        without it over that with it.
    """
    without, with_it, truth = (
        group.values(name, ENERGY, MOTION, steps) for name in (WITHOUT, MODEL, "truth")
    )
    return paired(without, truth), paired(with_it, truth), paired(without, with_it)


def energy_verdict(share: Ratio, relative: Ratio) -> str:
    """Decide whether the velocity field goes near 0 without the global feature.

    Args:
        share: Kinetic energy of rollouts without it over that of the truth at the same time.
        relative: The same over that of rollouts with it.
    """
    if share.side() > 0:
        return "refuted: it has more energy than the truth"
    if share.side() < 0 and relative.side() > 0:
        return "refuted: with the global feature there is even less energy"
    if share.side() < 0 and relative.side() < 0:
        if share.side(NEAR_ZERO) < 0:
            return "confirmed"
        return "confirmed in part: it has less energy than the truth, but is not near 0"
    return "not decided"
