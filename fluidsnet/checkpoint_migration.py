"""Migrate checkpoints of earlier versions to the current names."""

from __future__ import annotations

from typing import Any

import torch

from fluidsnet.checkpoint import NOTE, PREFIX
from fluidsnet.deprecated import with_current_names

_OLD_NOTE, _OLD_TWINS = "fluidsnet_blocks", "fluidsnet_twins"


def migrate(checkpoint: dict[str, Any]) -> None:
    """Rename the weights, notes and hyperparameters of an earlier version, in place.

    There the module was the model itself, twins were attached to it, and the global feature
    was called context.
    """
    if NOTE not in checkpoint:
        _rename(checkpoint)
    for model in checkpoint[NOTE]:
        # Until scenes could vary, what was trained on was not kept.
        for name, limit in (("lower", -torch.inf), ("upper", torch.inf)):
            weight = f"{PREFIX}{model}.network.scene_inputs.{name}"
            checkpoint["state_dict"].setdefault(weight, torch.full((5,), limit))


def _rename(checkpoint: dict[str, Any]) -> None:
    notes = {"model": checkpoint.pop(_OLD_NOTE, {}), **checkpoint.pop(_OLD_TWINS, {})}
    checkpoint[NOTE] = {model: with_current_names(note) for model, note in notes.items()}
    checkpoint["hyper_parameters"] = with_current_names(checkpoint.get("hyper_parameters", {}))
    checkpoint["state_dict"] = {
        _weight(name): value for name, value in checkpoint["state_dict"].items()
    }


def _weight(name: str) -> str:
    owner, rest = "model", name
    if name.startswith("twins."):
        _, owner, rest = name.split(".", 2)
    rest = rest.replace("network.context.", "network.global_feature.", 1)
    return f"{PREFIX}{owner}.{rest}" if rest.startswith(("network.", "time_step")) else name
