"""Frames of a simulation in a data file."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from datamodules.schema import DAMAGE, Header, SceneAttributes, open_valid, simulations
from fluidsnet.errors import UserError
from fluidsnet.export.frames import Frame, Frames


def data_frames(path: Path, simulation: str | None) -> Frames:
    """Return the frames of a simulation, in the coordinates of the file.

    Args:
        path: Data file.
        simulation: Name of the simulation; None for the first.

    Raises:
        UserError: It is not a data file, or has no such simulation.
    """
    with open_valid(path) as file:
        names = simulations(file)
        name = names[0] if simulation is None else simulation
        if name not in names:
            raise UserError(
                f"{path}: there is no simulation {name}; the file has {len(names)}, from "
                f"{names[0]} to {names[-1]}."
            )
        times = np.asarray(file[name]["time"], np.float64)
        scene, radius = SceneAttributes.read(file[name]), Header.read(file).particle_radius

    def read(index: int) -> Frame:
        try:
            with h5py.File(path, "r") as file:
                group = file[name]
                return Frame.of(
                    float(times[index]), group["position"][index], group["velocity"][index]
                )
        except DAMAGE as error:
            raise UserError(f"{path}: /{name}: frame {index} is damaged: {error}.") from error

    if not (np.diff(times) > 0).all():
        raise UserError(f"{path}: /{name}/time does not increase from frame to frame.")
    indices = range(len(times))
    return Frames(f"{path}, /{name}", times, indices, read, radius, scene.gravity, scene.dimension)
