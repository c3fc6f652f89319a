"""Load the network that a study measures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
import yaml
from jsonargparse import ArgumentParser

import fluidsnet.neighbors
from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet
from fluidsnet.neighbors import NeighborSearch
from fluidsnet.studies.dam_break import CELLS

# Arguments of training, and the grid, which a study sets.
_IGNORED = ("optimizer", "schedule", "noise", "grid_shape")


def load_model(model: str | None, run: str | None, neighbors: str, time_step: float) -> FluidsNet:
    """Return a network in evaluation mode with the given neighbor search.

    Args:
        model: Config file with the key `model`, such as configs/model/field.yaml, for a network
            with random weights; by default the paper's network.
        run: Folder of a training run, for the network and weights of its checkpoint.
        neighbors: Name of a class of `fluidsnet.neighbors`.
        time_step: Time step of the network, s.

    Raises:
        UserError: A file is missing or not valid, or the run was trained at another time step.
    """
    torch.manual_seed(0)
    weights: dict[str, Any] = {}
    grid_shape = CELLS
    if run is not None:
        folder = Path(run)
        model = str(folder / "config.yaml")
        checkpoint = _checkpoint(folder)
        weights, grid_shape = (
            checkpoint["state_dict"],
            tuple(checkpoint["hyper_parameters"]["grid_shape"]),
        )
        trained = float(weights["time_step"])
        if abs(trained - time_step) > 1e-6 * trained:
            raise UserError(
                f"{run} was trained at a time step of {trained:g} s, not {time_step:g} s; "
                f"add --time_step {trained:g}."
            )
    module = FluidsNet(grid_shape) if model is None else _configured(Path(model), grid_shape)
    if weights:
        module.load_state_dict(weights)
    module.network.neighbors = search(neighbors, module.network.neighbors.k)
    return module.eval()


def search(name: str, k: int) -> NeighborSearch:
    """The search of this name.

    Args:
        name: of a class of `fluidsnet.neighbors`.
        k: the most neighbors a particle has.
    """
    made: NeighborSearch = getattr(fluidsnet.neighbors, name)(k)
    return made


def _checkpoint(folder: Path) -> dict[str, Any]:
    for name in ("best.ckpt", "last.ckpt"):
        path = folder / "checkpoints" / name
        if path.exists():
            # Weights and plain settings only: a checkpoint may come from someone else.
            checkpoint: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
            return checkpoint
    raise UserError(f"{folder} is not the folder of a run: it has no checkpoints/best.ckpt.")


def _configured(path: Path, grid_shape: tuple[int, ...]) -> FluidsNet:
    try:
        described: dict[str, Any] = dict(yaml.safe_load(path.read_text())["model"])
    except (OSError, TypeError, KeyError, ValueError, yaml.YAMLError) as error:
        raise UserError(
            f"{path} holds no `model:`; name a file such as configs/model/paper.yaml."
        ) from error
    settings = dict(described.get("init_args") or {})
    for name in _IGNORED:
        settings.pop(name, None)
    parser = ArgumentParser(exit_on_error=False)
    parser.add_subclass_arguments(FluidsNet, "model")
    try:
        options = parser.parse_object(
            {"model": {**described, "init_args": {**settings, "grid_shape": list(grid_shape)}}}
        )
        module: FluidsNet = parser.instantiate(options).model
    except (ValueError, TypeError) as error:
        raise UserError(f"{path} does not describe a FluidsNet: {error}") from error
    return module
