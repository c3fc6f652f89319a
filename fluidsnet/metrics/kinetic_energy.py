"""`kinetic_energy`: whether a rollout moves as much as the truth."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.mean_of_squares import mean_of_squares
from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class KineticEnergy(RolloutMetric):
    """Kinetic energy: its relative error over the first n steps, and itself after them.

    With E the energy of all particles, the error is Σ|Ê - E| / ΣE over steps 1 to n: an
    instant of rest, where a ratio means nothing, weighs nothing. 0 is perfect; a fluid that
    stands still is off by 1. The energy itself is per mass, J/kg.
    """

    names = ("kinetic_energy", "kinetic_energy_j_per_kg")
    components = 2
    of_truth = True

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        return torch.stack([_per_mass(predicted), _per_mass(true)])

    def finish(self, values: Tensor) -> Tensor:
        predicted, true = values.unbind(dim=2)
        error = (predicted - true).abs().cumsum(dim=1)
        tiny = torch.finfo(values.dtype).tiny
        return torch.stack([error / true.cumsum(dim=1).clamp_min(tiny), predicted], dim=2)


def _per_mass(particles: Particles) -> Tensor:
    return 1.5 * mean_of_squares(particles.velocity)
