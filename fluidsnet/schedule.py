"""Learning rate schedule."""

from __future__ import annotations

from typing import final

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR


@final
class HalfwayDrop(LambdaLR):
    """The paper's schedule (section 5.3): full rate in the first half, 1/20 in the second.

    Args:
        optimizer: Optimizer to schedule.
        total_steps: Number of steps of the whole run.
        factor: Factor on the rate in the second half.
    """

    def __init__(self, optimizer: Optimizer, total_steps: int, factor: float = 0.05) -> None:
        super().__init__(optimizer, lambda step: 1.0 if 2 * step < total_steps else factor)
