"""What a checkpoint says of the models it holds, so that no other ones take their weights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fluidsnet.errors import UserError
from fluidsnet.model import Model

_KEY, _TWINS = "fluidsnet_blocks", "fluidsnet_twins"
# What the weights belong to; the rest of a model may be another one than it was trained with.
_TRAINED = ("local", "global_feature", "target", "grid_shape")


def describe(checkpoint: dict[str, Any], models: Mapping[str, Model]) -> None:
    """Notes the models' blocks, and drops hyperparameters that are not plain values.

    Lightning reads checkpoints with torch's `weights_only`, which refuses objects of ours: a
    module built in Python has blocks as hyperparameters, and from a config their descriptions.

    Args:
        checkpoint: changed in place.
        models: ``model``, and its twins.
    """
    described = {name: _blocks(model) for name, model in models.items()}
    main = described.pop("model")
    checkpoint[_KEY] = {name: block for name, block in main.items() if name in _TRAINED}
    if described:
        # What makes a twin is a part of it, with or without weights.
        checkpoint[_TWINS] = {
            twin: {
                name: block
                for name, block in blocks.items()
                if name in _TRAINED or block != main.get(name)
            }
            for twin, blocks in described.items()
        }
    settings: dict[str, Any] = checkpoint.get("hyper_parameters", {})
    for name in [name for name, value in settings.items() if not _is_plain(value)]:
        del settings[name]


def check(checkpoint: dict[str, Any], model: Model) -> None:
    """Compares a checkpoint's blocks with a model's.

    Raises:
        UserError: they differ, so that the weights would not fit, or mean something else.
    """
    for name, there, here in _differing(checkpoint.get(_KEY, {}), model):
        if name == "grid_shape":
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


def check_twins(
    checkpoint: dict[str, Any], models: Mapping[str, Model], resumed: bool
) -> list[str]:
    """Compares a checkpoint's twins with those of a model.

    Args:
        checkpoint: loses, in place, the weights of twins that the model does not have.
        models: ``model``, and its twins.
        resumed: whether training goes on, which no twin can leave.

    Returns:
        names of the twins that were left out.

    Raises:
        UserError: a twin's weights are missing or another's, or one would leave a training.
    """
    saved: dict[str, dict[str, Any]] = checkpoint.get(_TWINS, {})
    for twin in models.keys() - {"model"}:
        if twin not in saved:
            raise UserError(
                f"This checkpoint holds no twin {twin!r}: leave out the callback Ablation of that "
                "name, or train the two beside each other from the start."
            )
        for name, there, here in _differing(saved[twin], models[twin]):
            raise UserError(
                f"The twin {twin!r} of this checkpoint has the {name} {there}, and the callback "
                f"Ablation makes one with {here}: give it the block and the variant that the "
                "checkpoint was made with."
            )
    left_out = sorted(saved.keys() - models.keys())
    if left_out and resumed:
        raise UserError(
            f"This checkpoint was trained beside a twin {left_out[0]!r}: resume it with the "
            "callback Ablation that it was trained with."
        )
    weights: dict[str, Any] = checkpoint["state_dict"]
    for name in list(weights):
        if name.startswith(tuple(f"twins.{twin}." for twin in left_out)):
            del weights[name]
    return left_out


def _blocks(model: Model) -> dict[str, Any]:
    blocks: dict[str, Any] = {
        name: "null" if block is None else type(block).__name__
        for name, block in model.blocks().items()
    }
    if model.network.global_feature.needs_its_grid:
        blocks["grid_shape"] = list(model.network.grid_shape)
    return blocks


def _differing(saved: Mapping[str, Any], model: Model) -> list[tuple[str, Any, Any]]:
    """Name, what is saved and what is here, of each block in which the two differ."""
    here = _blocks(model)
    return [
        (name, there, here[name])
        for name, there in saved.items()
        if name in here and there != here[name]
    ]


def _grid(cells: list[int]) -> str:
    return " x ".join(map(str, cells))


def _is_plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_is_plain(item) for pair in value.items() for item in pair)
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or type(value) in (bool, int, float, str)
