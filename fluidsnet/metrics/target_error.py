"""`val/loss`: how far the head's output is off, in the units it is trained in."""

from __future__ import annotations

from typing import final

from torch import Tensor

from fluidsnet.metrics.frame_mean import FrameMean
from fluidsnet.metrics.velocity_mse import squared_error
from fluidsnet.particles import Particles


@final
class TargetError(FrameMean):
    """Mean of (output - expected)² per component of the target; of order one at the start."""

    def update(
        self, output: Tensor, expected: Tensor, particles: Particles, simulation: Tensor
    ) -> None:
        """Adds a batch: output and what would be right, (N, width); `simulation` as in `add`."""
        self.add(squared_error(output, expected), particles, simulation)
