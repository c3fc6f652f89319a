"""The network a study measures."""

from __future__ import annotations

from pathlib import Path

import torch

import fluidsnet.neighbors
from fluidsnet.errors import UserError
from fluidsnet.models.loading import build, read_checkpoint
from fluidsnet.module import FluidsNet
from fluidsnet.neighbors import NeighborSearch
from fluidsnet.studies.dam_break import CELLS


def load_model(model: str | None, run: str | None, neighbors: str, time_step: float) -> FluidsNet:
    """A network in evaluation mode, with a search of the study's choice.

    Args:
        model: a file with a `model:`, such as configs/model/field.yaml; its weights are random.
            Without one it is the paper's network.
        run: the folder of a training run; its network has the weights of its checkpoint.
        neighbors: name of a class of `fluidsnet.neighbors`.
        time_step: s that the network is to step.

    Raises:
        UserError: a file is missing or holds no such thing, or the run was trained at another
            time step.
    """
    torch.manual_seed(0)
    if run is not None:
        checkpoint = read_checkpoint(Path(run))
        module = build(Path(run, "config.yaml"), checkpoint["hyper_parameters"]["grid_shape"])
        module.on_load_checkpoint(checkpoint)
        module.load_state_dict(checkpoint["state_dict"])
        trained = float(module.model.time_step)
        if abs(trained - time_step) > 1e-6 * trained:
            raise UserError(
                f"{run} was trained at a time step of {trained:g} s, not {time_step:g} s; "
                f"add --time_step {trained:g}."
            )
    elif model is not None:
        module = build(Path(model), CELLS)
    else:
        module = FluidsNet(CELLS)
    network = module.model.network
    network.neighbors = search(neighbors, network.neighbors.k)
    return module.eval()


def search(name: str, k: int) -> NeighborSearch:
    """The search of this name.

    Args:
        name: of a class of `fluidsnet.neighbors`.
        k: the most neighbors a particle has.
    """
    made: NeighborSearch = getattr(fluidsnet.neighbors, name)(k)
    return made
