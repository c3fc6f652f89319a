"""Checkpoints: a note of the models' blocks, checked when weights are loaded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fluidsnet.errors import UserError
from fluidsnet.model import Model

#: Key of the note in a checkpoint: for each model the class of each block, and the grid.
NOTE = "fluidsnet_models"
#: Prefix of the models' weights in the state dict.
PREFIX = "models."
_GRID, _DIMENSION = "grid_shape", "dimension"

Note = dict[str, dict[str, Any]]


def describe(checkpoint: dict[str, Any], models: Mapping[str, Model]) -> None:
    """Note the models' blocks in a checkpoint, and drop hyperparameters that are objects.

    Lightning reads checkpoints with torch's `weights_only`, which refuses objects. A module
    built in Python has blocks as hyperparameters; one built from a config has plain values.

    Args:
        checkpoint: Changed in place.
        models: "model" and its twins.
    """
    checkpoint[NOTE] = {name: _note(model) for name, model in models.items()}
    settings: dict[str, Any] = checkpoint.get("hyper_parameters", {})
    for name in [name for name, value in settings.items() if not _is_plain(value)]:
        del settings[name]


def check(checkpoint: dict[str, Any], models: Mapping[str, Model], resumed: bool) -> list[str]:
    """Check that a checkpoint matches the models it is loaded into.

    Args:
        checkpoint: Loses, in place, the weights of twins that are not among the models, and gets
            those of models that have no network.
        models: "model" and its twins.
        resumed: Whether training continues, which needs every twin.

    Returns:
        Names of the twins that were left out.

    Raises:
        UserError: Blocks differ, a twin is missing on either side, or the weights of a block are
            those of an earlier version and cannot be converted.
    """
    saved: Note = checkpoint.get(NOTE, {})
    for name in models:
        _check_current(checkpoint["state_dict"], f"{PREFIX}{name}.network.")
    dimension = saved.get("model", {}).get(_DIMENSION, 3)
    present = models["model"].network.dimension
    if dimension != present:
        raise UserError(
            f"This network was trained in {dimension} dimensions, and the data have {present}."
        )
    for block, there, here in _differences(saved.get("model", {}), models["model"]):
        if block == _GRID:
            raise UserError(
                f"This network was trained on a background grid of {_grid(there)} cells, and the "
                f"data give {_grid(here)}: set data.voxel_size so that the two agree; a scene "
                "scaled by s takes a voxel size scaled by s."
            )
        raise UserError(
            f"This checkpoint was made with the {block} {there}, and this network has {here}: "
            f"build it as it was trained, with the run's own config.yaml (--run) or, in Python, "
            f"load_from_checkpoint(path, {block}=…)."
        )
    for name in models.keys() - {"model"}:
        if not models[name].network.target.width:
            # Without a network there is nothing to load.
            own = {f"{PREFIX}{name}.{key}": it for key, it in models[name].state_dict().items()}
            checkpoint["state_dict"].update(own)
            continue
        if name not in saved:
            raise UserError(
                f"This checkpoint holds no twin {name!r}: leave out the callback Ablation of that "
                "name, or train the two beside each other from the start."
            )
        for block, there, here in _differences(saved[name], models[name], twin_of=saved["model"]):
            raise UserError(
                f"The twin {name!r} of this checkpoint has the {block} {there}, and the callback "
                f"Ablation makes one with {here}: give it the block and the variant that the "
                "checkpoint was made with."
            )
    _check_shapes(checkpoint, models)
    left_out = sorted(saved.keys() - models.keys())
    if left_out and resumed:
        raise UserError(
            f"This checkpoint was trained beside a twin {left_out[0]!r}: resume it with the "
            "callback Ablation that it was trained with."
        )
    prefixes = tuple(f"{PREFIX}{name}." for name in left_out)
    weights: dict[str, Any] = checkpoint["state_dict"]
    for name in [name for name in weights if name.startswith(prefixes)]:
        del weights[name]
    return left_out


def _check_shapes(checkpoint: Mapping[str, Any], models: Mapping[str, Model]) -> None:
    """Check that the weights of a checkpoint fit the models.

    Raises:
        UserError: A weight is missing on one side, or has another shape.
    """
    saved: Mapping[str, Any] = checkpoint["state_dict"]
    for name, model in models.items():
        prefix = f"{PREFIX}{name}."
        there = {
            key.removeprefix(prefix): tuple(value.shape)
            for key, value in saved.items()
            if key.startswith(prefix)
        }
        here = {key: tuple(value.shape) for key, value in model.state_dict().items()}
        differing = [key for key in {**here, **there} if here.get(key) != there.get(key)]
        if not differing:
            continue
        key = differing[0]
        block = key.removeprefix("network.").partition(".")[0]
        known = (
            f"the checkpoint holds it with shape {list(there[key])}"
            if key in there
            else ("the checkpoint does not hold it")
        )
        needed = f"this network needs {list(here[key])}" if key in here else "this network has none"
        raise UserError(
            f"The weights of this checkpoint do not fit model.{block}: of {prefix}{key} {known}, "
            f"and {needed}. Set model.{block} as it was trained, in the run's own config.yaml "
            "(--run)."
        )


def _check_current(weights: Mapping[str, Any], prefix: str) -> None:
    """Check that no block of a model has weights of an earlier version.

    Args:
        weights: State dict of the checkpoint.
        prefix: Prefix of the names of the model's weights.

    Raises:
        UserError: One has.
    """
    # Until the field was sparse it had the weights of nn.Conv3d, (channels, inputs, 3, 3, 3).
    kernel = weights.get(f"{prefix}global_feature.enter.weight")
    if kernel is not None and kernel.ndim == 5:
        raise UserError(
            "The global_feature VoxelField of this checkpoint covered the whole domain, and that "
            "of this version covers only the cells around particles: train the network again."
        )
    drift = f"{prefix}target.drift_deviation"
    if drift in weights:
        raise UserError(
            f"The target DisplacementTarget of this checkpoint has its deviation in m, {drift}, "
            "and that of this version in support radii: train the network again, or replace that "
            f"entry of the state_dict by {prefix}target.drift_radii, divided by the support "
            "radius of the training data."
        )


def _note(model: Model) -> dict[str, Any]:
    """Return the class of each block, and the grid where weights are bound to it."""
    note: dict[str, Any] = {
        name: "null" if block is None else type(block).__name__
        for name, block in model.blocks().items()
    }
    if model.network.dimension != 3:
        note[_DIMENSION] = model.network.dimension
    if model.network.global_feature.needs_its_grid:
        note[_GRID] = list(model.network.grid_shape)
    return note


def _differences(
    saved: Mapping[str, Any], model: Model, twin_of: Mapping[str, Any] | None = None
) -> list[tuple[str, Any, Any]]:
    """Return name, saved and present class of each block that must agree and does not.

    Weights belong to the modules of the network and to the prior that they correct; the other
    blocks may be replaced after training. A twin is defined by the block that differs from its
    model's, whichever it is.
    """
    present = _note(model)
    bound = {_GRID, "prior", *dict(model.network.named_children())}
    if twin_of is not None:
        bound |= {name for name, block in saved.items() if block != twin_of.get(name)}
    return [
        (name, there, present[name])
        for name, there in saved.items()
        if name in bound and name in present and there != present[name]
    ]


def _grid(shape: list[int]) -> str:
    return " x ".join(map(str, shape))


def _is_plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_is_plain(item) for pair in value.items() for item in pair)
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or type(value) in (bool, int, float, str)
