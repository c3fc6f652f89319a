"""`density_error`: how far a rollout squeezes its fluid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.density import Density
from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class DensityError(RolloutMetric):
    """Excess of density, max(0, ρ/ρ₀ - 1), after n steps: its mean and 99.9th percentile.

    The density is SPH's (`Density`); too little of it is no error, since at a surface there
    is too little. Judge it beside the truth's own, which the solver's tolerance, the fluid's
    first frames and a data set of other masses keep from zero.

    Args:
        simulations: as of every rollout's metric.
        steps: as well.
        density: shared, so that the solids' share is found once.
    """

    names = ("density_error", "density_error_999")
    components = 2
    costly = True
    of_truth = True

    def __init__(
        self, simulations: Sequence[int], steps: int, density: Density | None = None
    ) -> None:
        super().__init__(simulations, steps)
        self.density = density or Density()

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        excess = (self.density(predicted) - 1).clamp_min(0)
        figures = torch.stack([excess.mean(), excess.quantile(0.999)])
        return figures.where(excess.isfinite().all(), torch.inf)
