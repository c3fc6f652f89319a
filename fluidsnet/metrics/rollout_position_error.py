"""`position_error`: how far a rollout's particles are off after n steps."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.position_error import distance_mm
from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class RolloutPositionError(RolloutMetric):
    """Mean Euclidean distance ‖x̂ - x‖ after n steps, mm and particle radii.

    After one and two steps it is the n1 and n2 of Ummenhofer et al. 2020 (CConv).
    """

    names = ("position_error_mm", "position_error_radii")
    components = 2

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        error = distance_mm(predicted.position, true.position).mean()
        return torch.stack([error, error / (1000 * true.scene.particle_radius)])
