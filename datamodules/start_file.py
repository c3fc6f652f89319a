"""Data file of one state: writing a start that no solver stepped."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.schema import COMPRESSION, Header, SceneAttributes, create_frames
from fluidsnet.disk_space import check_space

Points = NDArray[np.floating[Any]]


def start_header(scene: str, particle_radius: float, frame_interval: float) -> Header:
    """Return the header of a file whose states no solver made.

    Args:
        scene: Name of the kind of scene.
        particle_radius: m.
        frame_interval: Time between two frames, s.
    """
    return Header(
        scene=scene,
        solver="none",
        solver_version="none",
        solver_parameters={},
        particle_radius=particle_radius,
        support_radius=4 * particle_radius,
        dt=frame_interval,
    )


def write_start(
    path: Path,
    header: Header,
    scene: SceneAttributes,
    fluid: tuple[Points, Points],
    solids: Points,
    frames: int = 1,
    seed: Sequence[int] = (),
) -> None:
    """Write a data file of one simulation whose frames are all equal.

    Args:
        path: Path of the file.
        header: Attributes of the file.
        scene: Attributes of the simulation.
        fluid: Position, m, and velocity, m/s, of the fluid particles, (N, 3) each.
        solids: (M, 3) of the solid particles, m.
        frames: Number of frames.
        seed: Seed of the random generator that drew the scene.

    Raises:
        UserError: The disk is full.
    """
    check_space(path, 8 * (frames * sum(it.size for it in fluid) + solids.size))
    with h5py.File(path, "w") as file:
        header.write(file)
        group = file.create_group("00000")
        scene.write(group)
        group.attrs["seed"], group.attrs["threads"] = json.dumps([*seed]), 1
        group.attrs["scene_parameters"] = "[]"
        for data, values in zip(create_frames(group, len(fluid[0])), fluid, strict=True):
            data.resize(frames, axis=0)
            data[:] = values.astype(np.float32)
        group["time"] = header.dt * np.arange(frames)
        group["solver_seconds"] = np.zeros(frames)
        group.create_dataset("solid_position", data=solids.astype(np.float32), **COMPRESSION)
