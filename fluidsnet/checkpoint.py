"""What a checkpoint says of the network it holds, so that no other one takes its weights."""

from __future__ import annotations

from typing import Any

from fluidsnet.errors import UserError
from fluidsnet.network import Network

_KEY = "fluidsnet_blocks"


def describe(checkpoint: dict[str, Any], network: Network) -> None:
    """Notes the network's blocks, and drops hyperparameters that are not plain values.

    Lightning reads checkpoints with torch's `weights_only`, which refuses objects of ours: a
    module built in Python has blocks as hyperparameters, and from a config their descriptions.
    """
    checkpoint[_KEY] = _blocks(network)
    settings: dict[str, Any] = checkpoint.get("hyper_parameters", {})
    for name in [name for name, value in settings.items() if not _is_plain(value)]:
        del settings[name]


def check(checkpoint: dict[str, Any], network: Network) -> None:
    """Compares a checkpoint's blocks with the network's.

    Raises:
        UserError: they differ, so that the weights would not fit, or mean something else.
    """
    saved: dict[str, Any] = checkpoint.get(_KEY, {})
    for name, here in _blocks(network).items():
        there = saved.get(name, here)
        if there == here:
            continue
        if name == "cells":
            raise UserError(
                f"This network was trained on a background grid of {_grid(there)} cells, and the "
                f"data give {_grid(here)}: set data.voxel_size so that the two agree; a scene "
                "scaled by s takes a voxel size scaled by s."
            )
        raise UserError(
            f"This checkpoint was made with the {name} {there}, and this network has {here}: "
            f"build it as it was trained, with the run's own config.yaml (--run) or, in Python, "
            f"load_from_checkpoint(path, {name}=…)."
        )


def _blocks(network: Network) -> dict[str, Any]:
    blocks: dict[str, Any] = {
        name: type(getattr(network, name)).__name__ for name in ("local", "context", "target")
    }
    if network.context.needs_its_grid:
        blocks["cells"] = list(network.cells)
    return blocks


def _grid(cells: list[int]) -> str:
    return " x ".join(map(str, cells))


def _is_plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_is_plain(item) for pair in value.items() for item in pair)
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or type(value) in (bool, int, float, str)
