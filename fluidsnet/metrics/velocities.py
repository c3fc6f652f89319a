"""Metrics of the velocities in a rollout: their error, and the kinetic energy."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.base import RolloutMetric
from fluidsnet.particles import Particles


@final
class RolloutVelocityMSE(RolloutMetric):
    """Mean of (v̂ - v)² per component after n steps, m²/s²."""

    knows_periodic = True
    names = ("velocity_mse",)

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        axes = true.scene.dimension
        return mean_of_squares(predicted.velocity - true.velocity)[None] * (3 / axes)


@final
class KineticEnergy(RolloutMetric):
    """Relative error of the kinetic energy over the first n steps, and the energy after them.

    The error is Σ|Ê - E| / ΣE over steps 1 to n, with the energy E of all particles, so a moment
    at rest, where a ratio is undefined, has no weight. 0 is perfect; a fluid at rest has 1. The
    energy is per mass, J/kg.
    """

    knows_periodic = True
    names = ("kinetic_energy", "kinetic_energy_j_per_kg")
    components = 2
    of_truth = True

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        return torch.stack([1.5 * mean_of_squares(state.velocity) for state in (predicted, true)])

    def finish(self, values: Tensor) -> Tensor:
        predicted, true = values.unbind(dim=2)
        error = (predicted - true).abs().cumsum(dim=1)
        tiny = torch.finfo(values.dtype).tiny
        return torch.stack([error / true.cumsum(dim=1).clamp_min(tiny), predicted], dim=2)


def mean_of_squares(values: Tensor) -> Tensor:
    """Return the mean of the squares of all values, () float64, without a float64 copy of them."""
    norm: Tensor = torch.linalg.vector_norm(values, dtype=torch.float64)
    return norm.square() / values.numel()
