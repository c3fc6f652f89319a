"""`velocity_mse` along a rollout: how far velocities are off after n steps."""

from __future__ import annotations

from typing import final

from torch import Tensor

from fluidsnet.metrics.mean_of_squares import mean_of_squares
from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class RolloutVelocityMSE(RolloutMetric):
    """Mean of (v̂ - v)² per component after n steps, m²/s²."""

    names = ("velocity_mse",)

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        return mean_of_squares(predicted.velocity - true.velocity)[None]
