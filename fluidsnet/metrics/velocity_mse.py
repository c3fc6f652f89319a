"""`velocity_mse`: how far predicted velocities are off, one step from a true state."""

from __future__ import annotations

from typing import final

from torch import Tensor

from fluidsnet.metrics.frame_mean import FrameMean
from fluidsnet.particles import Particles


@final
class VelocityMSE(FrameMean):
    """Mean of (v̂ - v)² per component, m²/s²."""

    def update(
        self, predicted: Tensor, true: Tensor, particles: Particles, simulation: Tensor
    ) -> None:
        """Adds a batch: predicted and true velocities (N, 3), m/s; `simulation` as in `add`."""
        self.add(squared_error(predicted, true), particles, simulation)


def squared_error(predicted: Tensor, true: Tensor) -> Tensor:
    """Mean over the components of (predicted - true)², (N,), from (N, 3) each."""
    return (predicted.double() - true.double()).square().mean(dim=1)
