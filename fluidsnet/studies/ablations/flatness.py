"""Whether a model was trained until it learned no more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from fluidsnet.report.events import Curve

#: A change that is less is flat.
FLAT = 0.05


@dataclass(frozen=True)
class Flatness:
    """How a curve ends.

    Attributes:
        change: of the mean over the last eighth of training, relative to that over the eighth
            before; not a number where one of these is not finite; None where one has no point.
    """

    change: float | None

    @classmethod
    def of(cls, curve: Curve, steps: int) -> Flatness:
        """Of a curve.

        Args:
            curve: (step, value), the first step being 0.
            steps: of the training.
        """
        # Whole numbers, as a validation may fall on a boundary: it is of the part it ends.
        last = [value for step, value in curve if 8 * (step + 1) > 7 * steps]
        before = [value for step, value in curve if 6 * steps < 8 * (step + 1) <= 7 * steps]
        if not last or not before:
            return cls(None)
        new, old = fmean(last), fmean(before)
        known = math.isfinite(new) and math.isfinite(old) and old > 0
        return cls(new / old - 1 if known else math.nan)

    def __str__(self) -> str:
        if self.change is None:
            return "too few validations"
        if math.isnan(self.change):
            return "not finite"
        if abs(self.change) < FLAT:
            return "flat"
        return f"{'falls' if self.change < 0 else 'rises'} {100 * abs(self.change):.2g} %"


def worst(found: Sequence[Flatness]) -> Flatness:
    """Of several curves, the one of which least can be said, or that changes most."""

    def rank(one: Flatness) -> tuple[int, float]:
        if one.change is None:
            return 2, 0.0
        return (1, 0.0) if math.isnan(one.change) else (0, abs(one.change))

    return max(found, key=rank)
