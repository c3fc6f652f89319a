"""Optimizer and gradient clipping of models that are trained side by side."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from lightning import LightningModule
from torch.nn.utils import clip_grad_norm_, clip_grad_value_
from torch.optim import Adam, Optimizer

from fluidsnet.errors import UserError


def adam(parameters: Iterable[Any]) -> Optimizer:
    """Build the paper's optimizer (section 5.3), Adam at 0.003, for weights or groups of them."""
    return Adam(parameters, lr=0.003)


def total_steps(module: LightningModule) -> int:
    """Return the number of steps of the whole run, for the learning rate schedule.

    Raises:
        UserError: The number of steps is not limited.
    """
    steps = module.trainer.estimated_stepping_batches
    if steps == float("inf"):
        raise UserError(
            "The learning rate schedule needs the number of training steps: "
            "set trainer.max_epochs or trainer.max_steps."
        )
    return int(steps)


def clip_each(optimizer: Optimizer, limit: float, algorithm: str | None) -> None:
    """Clip the gradients of each parameter group separately.

    Clipped together, a large gradient of one model would shorten the steps of the others.

    Args:
        optimizer: Optimizer with one group per model.
        limit: Maximum norm of a group's gradients, or maximum absolute value.
        algorithm: ``value`` for the latter; the norm by default.
    """
    for group in optimizer.param_groups:
        parameters: Any = group["params"]
        if algorithm == "value":
            clip_grad_value_(parameters, limit)
        else:
            clip_grad_norm_(parameters, limit)
