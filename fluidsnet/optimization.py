"""How models that train beside each other are optimized: each as if it were alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from lightning import LightningModule
from torch.nn.utils import clip_grad_norm_, clip_grad_value_
from torch.optim import Adam, Optimizer

from fluidsnet.errors import UserError


def adam(parameters: Iterable[Any]) -> Optimizer:
    """The paper's (section 5.3): Adam at 0.003, for weights or groups of them."""
    return Adam(parameters, lr=0.003)


def total_steps(module: LightningModule) -> int:
    """The number of steps of the whole run, which the learning rate's schedule goes by.

    Raises:
        UserError: training has no end.
    """
    steps = module.trainer.estimated_stepping_batches
    if steps == float("inf"):
        raise UserError(
            "The learning rate's schedule needs to know where training ends: "
            "set trainer.max_epochs or trainer.max_steps."
        )
    return int(steps)


def clip_each(optimizer: Optimizer, most: float, algorithm: str | None) -> None:
    """Clips the gradients of each group of an optimizer by themselves.

    Clipped together, a steep gradient of one model would shorten the steps of the other.

    Args:
        optimizer: with a group a model.
        most: norm of a group's gradients, or size of each number of them.
        algorithm: ``value`` for the latter; the norm by default.
    """
    for group in optimizer.param_groups:
        parameters: Any = group["params"]
        if algorithm == "value":
            clip_grad_value_(parameters, most)
        else:
            clip_grad_norm_(parameters, most)
