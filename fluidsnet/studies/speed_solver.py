"""How long the solver takes, and the states that it leaves."""

from __future__ import annotations

from pathlib import Path

import h5py

from datamodules.generate.dataset import generate
from datamodules.generate.recipe import Recipe
from fluidsnet.studies.machine import OtherLoad
from fluidsnet.studies.speed_row import Row, spread


def time_solver(row: Row, recipe: Recipe, root: Path, threads: int, states: Path) -> None:
    """Fills in a solver's row.

    Args:
        row: of the solver.
        recipe: of one simulation.
        root: folder for the solver's files, which are removed.
        threads: of the solver.
        states: where the simulation is kept, unless another solver's is there.

    Raises:
        UserError: the solver cannot run, or failed.
    """
    try:
        with OtherLoad() as load:
            generate(recipe, root, processes=1, threads=threads)
        row.others = load.cores
        file = root / "train.h5"
        with h5py.File(file) as simulations:
            group = next(iter(simulations.values()))
            row.step = spread(group["solver_seconds"][1:].tolist())
            row.solids = len(group["solid_position"])
        if not states.exists():
            file.rename(states)
    finally:
        for left in root.glob("*"):
            left.unlink()
