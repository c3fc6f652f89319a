"""`position_error`: how far predicted positions are off."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.frame_mean import FrameMean
from fluidsnet.particles import Particles


@final
class PositionError(FrameMean):
    """Mean Euclidean distance ‖x̂ - x‖, mm."""

    def update(
        self, predicted: Tensor, true: Tensor, particles: Particles, simulation: Tensor
    ) -> None:
        """Adds a batch: predicted and true positions (N, 3), m; `simulation` as in `add`."""
        self.add(distance_mm(predicted, true), particles, simulation)


def distance_mm(predicted: Tensor, true: Tensor) -> Tensor:
    """Distance of each pair of rows, (N,) mm, from (N, 3) m each."""
    distance: Tensor = 1000 * torch.linalg.vector_norm(predicted.double() - true.double(), dim=1)
    return distance
