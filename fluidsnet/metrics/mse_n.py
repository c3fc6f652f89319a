"""`mse_n`: LagrangeBench's error of positions over a rollout."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.mean_of_squares import mean_of_squares
from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class MSEn(RolloutMetric):
    """Mean of (x̂ - x)² over the first n steps, particles and axes, m².

    As Toshev et al. 2023 (LagrangeBench) have it, but for their walls: over fluid alone.
    """

    names = ("mse_n_m2",)

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        return mean_of_squares(predicted.position - true.position)[None]

    def finish(self, values: Tensor) -> Tensor:
        steps = torch.arange(1, values.shape[1] + 1, device=values.device)
        return values.cumsum(dim=1) / steps[:, None]
