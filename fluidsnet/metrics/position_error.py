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
    # A difference of two floats is as exact as they are.
    distance: Tensor = torch.linalg.vector_norm(predicted - true, dim=1, dtype=torch.float64)
    return 1000 * distance
