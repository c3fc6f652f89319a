"""Checks of what a callback needs."""

from __future__ import annotations

from typing import Any

from lightning import Callback, LightningModule, Trainer

from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet


def require_fluidsnet(callback: Callback, module: LightningModule) -> FluidsNet:
    """Return the module as a FluidsNet.

    Raises:
        UserError: it is another module.
    """
    if not isinstance(module, FluidsNet):
        raise UserError(
            f"The callback {type(callback).__name__} needs the model FluidsNet; the model is "
            f"{type(module).__name__}."
        )
    return module


def require_rollout_starts(callback: Callback, trainer: Trainer) -> Any:
    """Return the data module.

    Raises:
        UserError: it has no rollout starts.
    """
    data: Any = getattr(trainer, "datamodule", None)
    if not hasattr(data, "rollout_starts"):
        raise UserError(
            f"The callback {type(callback).__name__} needs a data module with rollout_starts, such "
            "as SPHDataModule."
        )
    return data


def is_first(callback: Callback, trainer: Trainer) -> bool:
    """Return True if no other callback of the same class comes before it."""
    callbacks: list[Callback] = trainer.callbacks  # type: ignore[attr-defined]
    return next(other for other in callbacks if isinstance(other, type(callback))) is callback
