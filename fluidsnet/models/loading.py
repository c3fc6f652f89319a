"""Load a model from the folder of a run, by its name if it is shipped, or from a config file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from jsonargparse import ArgumentParser

from fluidsnet.checkpoint_io import WholeCheckpoints
from fluidsnet.checkpoint_migration import migrate
from fluidsnet.deprecated import with_current_names
from fluidsnet.errors import UserError
from fluidsnet.model import Model
from fluidsnet.models.shipped import run_path, shipped_models
from fluidsnet.module import NEEDS, FluidsNet
from fluidsnet.plain_yaml import read_text, read_yaml

# Arguments that only training needs.
_TRAINING = ("optimizer", "schedule", "noise", "warm_up", *NEEDS)


def load(
    run: str | Path,
    device: torch.device | str = "cpu",
    prior: Mapping[str, Any] | None = None,
) -> Model:
    """Return a model in evaluation mode: that of a run, a shipped one, or a prior alone.

    Args:
        run: Folder of a run, such as runs/demo, with config.yaml and checkpoints/best.ckpt; name
            of a shipped model, such as box_drops; or config file of a prior alone, such as
            configs/model/prior.yaml.
        device: Device of the model's weights.
        prior: Arguments of the prior in place of those of the config, such as
            ``{"searches": 1}``; only of a prior alone, since a network corrects the one it was
            trained with.

    Raises:
        UserError: A file is missing, the checkpoint does not match the configuration, the config
            file describes a network, whose weights it does not have, or the prior of a network
            is to be changed.
    """
    path, config = run_path(run), config_path(run)
    if path == config or not has_weights(config):
        model = _prior_alone(config, prior or {})
    elif prior:
        raise UserError(f"{path}: the prior of a trained network cannot be changed.")
    else:
        model = _trained(path)
    return model.eval().requires_grad_(False).to(device)


def config_path(run: str | Path) -> Path:
    """Return the config file of a run or of a shipped model, or the path of a config itself.

    Raises:
        UserError: The folder has none.
    """
    path = run_path(run)
    if path.suffix in (".yaml", ".yml"):
        return path
    config = path / "config.yaml"
    if not config.exists():
        raise UserError(
            f"{path} is not the folder of a run: {config} is missing. These models ship with the "
            f"package: {', '.join(shipped_models())}."
        )
    return config


def has_weights(config: Path) -> bool:
    """Return whether the model of a config has weights, which a prior alone has not.

    Raises:
        UserError: The file cannot be read or describes no FluidsNet.
    """
    target = (_described(config).get("init_args") or {}).get("target")
    name = target.get("class_path") if isinstance(target, dict) else target
    return str(name).rpartition(".")[2] != "PriorAlone"


def _prior_alone(config: Path, prior: Mapping[str, Any]) -> Model:
    # Nothing of it depends on the grid.
    model = build(config, (1, 1, 1), prior).model
    if not model.is_trained:
        raise UserError(f"{config} describes a network without weights; name the folder of a run.")
    return model


def _trained(folder: Path) -> Model:
    checkpoint = read_checkpoint(folder)
    settings = checkpoint["hyper_parameters"]
    needs = {name: settings[name] for name in NEEDS if name in settings}
    module = build(folder / "config.yaml", **needs)
    module.on_load_checkpoint(checkpoint)
    try:
        module.load_state_dict(checkpoint["state_dict"])
    except RuntimeError as error:
        raise UserError(f"{folder}: the checkpoint does not fit config.yaml: {error}") from error
    return module.model


def checkpoint_path(folder: Path) -> Path:
    """Return the best checkpoint of a run, or the last where no validation chose a best.

    Raises:
        UserError: There is none.
    """
    for name in ("best.ckpt", "last.ckpt"):
        path = folder / "checkpoints" / name
        if path.exists():
            return path
    raise UserError(
        f"{folder} has no weights: {path} is missing. A training writes it at its first validation."
    )


def read_checkpoint(folder: Path) -> dict[str, Any]:
    """Read the checkpoint of a run; weights and plain settings only, on the CPU.

    Raises:
        UserError: There is none, it is damaged, or not that of its checksum.
    """
    path = checkpoint_path(folder)
    checkpoint = WholeCheckpoints().load_checkpoint(path)
    try:
        migrate(checkpoint)
    except (TypeError, KeyError, AttributeError) as error:
        raise UserError(f"{path} cannot be read; it is no checkpoint of FluidsNet.") from error
    return checkpoint


def build(
    config: Path,
    grid_shape: Sequence[int],
    prior: Mapping[str, Any] | None = None,
    dimension: int = 3,
    varying: Sequence[str] = (),
) -> FluidsNet:
    """Build an untrained module from the ``model:`` of a config file.

    Args:
        config: Such as configs/model/field.yaml or a run's config.yaml.
        grid_shape: Number of cells of the background grid along x, y and z.
        prior: Arguments of the prior in place of those of the config.
        dimension: Dimensions of the scenes, 2 or 3.
        varying: Values of the scene that vary between the training simulations.

    Raises:
        UserError: The file cannot be read or describes no FluidsNet.
    """
    described = _described(config)
    settings = with_current_names(dict(described.get("init_args") or {}))
    for name in _TRAINING:
        settings.pop(name, None)
    if prior:
        described_prior = dict(settings.get("prior") or {})
        given = dict(described_prior.get("init_args") or {})
        settings["prior"] = {**described_prior, "init_args": {**given, **prior}}
    parser = ArgumentParser(exit_on_error=False)
    parser.add_subclass_arguments(FluidsNet, "model")
    settings |= {"grid_shape": list(grid_shape), "dimension": dimension, "varying": list(varying)}
    try:
        options = parser.parse_object({"model": {**described, "init_args": settings}})
        with warnings.catch_warnings():
            # Blocks are modules; hyperparameters keep their descriptions.
            warnings.filterwarnings("ignore", ".*is already saved during checkpointing.*")
            module: FluidsNet = parser.instantiate(options).model
    except (ValueError, TypeError) as error:
        raise UserError(f"{config} does not describe a FluidsNet: {error}") from error
    return module


def _described(config: Path) -> dict[str, Any]:
    """Return the ``model:`` of a config file."""
    try:
        return dict(read_yaml(read_text(config))["model"])
    except (OSError, TypeError, KeyError, ValueError, yaml.YAMLError) as error:
        raise UserError(
            f"{config} holds no `model:`; name a file such as configs/model/paper.yaml."
        ) from error
