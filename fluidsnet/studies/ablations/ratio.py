"""Whether two models differ: the ratio of their figures, seed by seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from scipy.stats import t as student

#: With fewer, nothing is decided.
LEAST_SEEDS = 3


@dataclass(frozen=True)
class Ratio:
    """Ratios of two figures, each from one seed.

    Attributes:
        each: one a seed; infinite where the first figure alone is, not a number where both are.
    """

    each: tuple[float, ...]

    @classmethod
    def of(cls, pairs: Sequence[tuple[float, float]]) -> Ratio:
        """Of figures that are not negative, paired by seed."""
        return cls(tuple(_over(one, other) for one, other in pairs))

    @property
    def mean(self) -> float:
        """The geometric mean; not a number where there is no ratio."""
        if not self.each:
            return math.nan
        logs = [math.log(ratio) if ratio else -math.inf for ratio in self.each]
        mean = sum(logs) / len(logs)
        return _exp(mean)

    @property
    def interval(self) -> tuple[float, float] | None:
        """The mean's 95 % confidence interval, of Student's t over the logarithms.

        None with fewer than `LEAST_SEEDS`, and where a ratio is zero or not finite.
        """
        count = len(self.each)
        if count < LEAST_SEEDS or not all(0 < ratio < math.inf for ratio in self.each):
            return None
        logs = [math.log(ratio) for ratio in self.each]
        half = float(student.ppf(0.975, count - 1)) * stdev(logs) / math.sqrt(count)
        return _exp(fmean(logs) - half), _exp(fmean(logs) + half)

    def side(self, of: float = 1.0) -> int:
        """1 where the interval lies above a value, -1 where below, 0 where it is not decided."""
        if self.interval is None:
            return 0
        lower, upper = self.interval
        return int(lower > of) - int(upper < of)

    def __str__(self) -> str:
        if not self.each:
            return "unknown"
        if self.interval is None:
            broken = sum(not math.isfinite(ratio) for ratio in self.each)
            words = f" (not finite in {broken} of {len(self.each)} seeds)" if broken else ""
            return f"{digits(self.mean)}{words}"
        lower, upper = self.interval
        return f"{digits(self.mean)} [{digits(lower)}, {digits(upper)}]"


def digits(value: float) -> str:
    """Three significant digits, the last zeros too, so that a mean and its interval match."""
    if not math.isfinite(value):
        return f"{value:g}"
    text = f"{value:#.3g}"
    # The text decides: what is rounded up to 1,000 would have an exponent.
    return f"{value:,.0f}" if float(text) >= 1000 else text.rstrip(".")


def _exp(value: float) -> float:
    try:
        return math.exp(value)
    except OverflowError:
        return math.inf


def _over(one: float, other: float) -> float:
    if math.isinf(other):
        return math.nan if math.isinf(one) else 0.0
    if other == 0:
        return math.inf if one > 0 else math.nan
    return one / other
