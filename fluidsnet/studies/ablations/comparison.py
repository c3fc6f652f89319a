"""Comparison of each twin with its model: ratios with confidence intervals, seed by seed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from fluidsnet.studies.ablations.results import ACCELERATION, MODEL, REST, WITHOUT, Group

#: With fewer seeds nothing is decided.
_LEAST_SEEDS = 3
#: Metrics of rollouts from rest that are compared after the last step.
_ROLLOUT = ("position_error mm", "chamfer mm")


@dataclass(frozen=True)
class Ratio:
    """Ratios of two numbers, one per seed.

    Attributes:
        each: One per seed; infinite where only the first number is, NaN where both are.
    """

    each: tuple[float, ...]

    @classmethod
    def of(cls, pairs: Sequence[tuple[float, float]]) -> Ratio:
        """Divide the first number of each pair by the second; both at least 0."""
        first, second = np.array(pairs, dtype=float).reshape(-1, 2).T
        with np.errstate(all="ignore"):
            return cls(tuple((first / second).tolist()))

    @property
    def mean(self) -> float:
        """Geometric mean; NaN where there is no ratio."""
        with np.errstate(all="ignore"):
            return float(np.exp(np.log(self.each).mean())) if self.each else math.nan

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % confidence interval of the mean, by Student's t over the logarithms.

        None with fewer than three seeds, and where a ratio is zero or not finite.
        """
        count = len(self.each)
        if count < _LEAST_SEEDS or not all(0 < ratio < math.inf for ratio in self.each):
            return None
        logs = np.log(self.each)
        half = student.ppf(0.975, count - 1) * logs.std(ddof=1) / math.sqrt(count)
        with np.errstate(over="ignore"):
            return float(np.exp(logs.mean() - half)), float(np.exp(logs.mean() + half))

    def side(self, value: float = 1.0) -> int:
        """Return 1 where the interval lies above a value, -1 below, 0 where undecided."""
        if self.interval is None:
            return 0
        lower, upper = self.interval
        return int(lower > value) - int(upper < value)

    def __str__(self) -> str:
        if not self.each:
            return "unknown"
        if self.interval is None:
            count = sum(not math.isfinite(ratio) for ratio in self.each)
            note = f" (not finite in {count} of {len(self.each)} seeds)" if count else ""
            return f"{digits(self.mean)}{note}"
        lower, upper = self.interval
        return f"{digits(self.mean)} [{digits(lower)}, {digits(upper)}]"


def digits(value: float) -> str:
    """Format with three significant digits, trailing zeros kept, without an exponent."""
    if not math.isfinite(value):
        return f"{value:g}"
    text = f"{value:#.3g}"
    # Test the text, since 999.7 is rounded up to 1.00e+03.
    return f"{value:,.0f}" if float(text) >= 1000 else text.rstrip(".")


def paired(first: Mapping[int, float], second: Mapping[int, float]) -> Ratio:
    """Divide numbers by seed, for the seeds that have both."""
    return Ratio.of([(first[seed], second[seed]) for seed in first if seed in second])


def accuracy(group: Group, twin: str) -> Ratio:
    """Divide the twin's `velocity_mse` by the model's, one step ahead on the test split."""
    metric = "velocity_mse m²/s²"
    return paired(group.values(twin, metric), group.values(MODEL, metric))


@dataclass(frozen=True)
class Comparison:
    """A twin's metric over the model's.

    Attributes:
        twin: Name of the twin.
        group: The runs.
        metric: The metric in words.
        ratio: Above 1 where the model is better.
    """

    twin: str
    group: Group
    metric: str
    ratio: Ratio

    @property
    def decision(self) -> str:
        """Which of the two is better, in words."""
        return {1: "the model is better", -1: "the twin is better", 0: "not decided"}[
            self.ratio.side()
        ]


def compare(groups: Sequence[Group]) -> list[Comparison]:
    """Compare each twin with the model in each group that has it."""
    comparisons = []
    for twin in (ACCELERATION, WITHOUT):
        for group in groups:
            ratios = {"velocity_mse, one step": accuracy(group, twin)}
            for moment in group.moments(REST)[-1:]:
                for column in _ROLLOUT:
                    first, second = (
                        group.values(name, column, REST, moment.steps) for name in (twin, MODEL)
                    )
                    name = f"{column.partition(' ')[0]}, {moment.time:.4g} s"
                    ratios[name] = paired(first, second)
            comparisons += [
                Comparison(twin, group, metric, ratio)
                for metric, ratio in ratios.items()
                if ratio.each
            ]
    return comparisons
