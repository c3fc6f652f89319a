"""The learning rate over a training run."""

from __future__ import annotations

from typing import final

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR


@final
class HalfwayDrop(LambdaLR):
    """The paper's (section 5.3): the first half at the full rate, the second at 1/20 of it.

    Args:
        optimizer: whose rate falls.
        total_steps: of the whole run.
        factor: of the second half.
    """

    def __init__(self, optimizer: Optimizer, total_steps: int, factor: float = 0.05) -> None:
        super().__init__(optimizer, lambda step: 1.0 if 2 * step < total_steps else factor)
