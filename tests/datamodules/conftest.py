"""Fixture that writes small data files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from datamodules.schema import COMPRESSION, Header, SceneAttributes, create_frames

Write = Callable[..., Path]

HEADER: dict[str, Any] = {
    "scene": "DamBreak",
    "solver": "IISPH",
    "solver_version": "2.19.0",
    "solver_parameters": {"maxError": 0.05},
    "particle_radius": 0.05,
    "support_radius": 0.2,
    "dt": 0.02,
}
SCENE: dict[str, Any] = {
    "domain_lower": (0.0, 0.0, 0.0),
    "domain_upper": (1.5, 1.0, 1.5),
    "gravity": (0.0, -9.81, 0.0),
    "density0": 1000.0,
    "viscosity": 0.01,
}


@pytest.fixture
def write_file(tmp_path: Path) -> Write:
    """Write a valid file of random simulations, given their (frames, fluid, solid) sizes.

    Attributes of the header and the scene can be changed by name; a scene attribute that is a
    list has an entry for each simulation.
    """

    def write(name: str, *sizes: tuple[int, int, int], seed: int = 0, **changes: Any) -> Path:
        random = np.random.default_rng(seed)
        path = tmp_path / name
        names = {field.name for field in fields(SceneAttributes)}
        scene = {**SCENE, **{key: changes.pop(key) for key in names & changes.keys()}}
        described = Header(**{**HEADER, **changes})
        with h5py.File(path, "w") as file:
            described.write(file)
            for number, (frames, fluid, solid) in enumerate(sizes):
                group = file.create_group(f"{number:05d}")
                SceneAttributes(
                    **{
                        key: value[number] if isinstance(value, list) else value
                        for key, value in scene.items()
                    }
                ).write(group)
                group.attrs["seed"], group.attrs["threads"] = "[0]", 1
                group.attrs["scene_parameters"] = "[]"
                for dataset in create_frames(group, fluid):
                    dataset.resize(frames, axis=0)
                    dataset[...] = random.uniform(0.1, 0.9, size=(frames, fluid, 3))
                group["time"] = described.dt * np.arange(frames)
                group["solver_seconds"] = np.full(frames, 0.1)
                group.create_dataset(
                    "solid_position",
                    data=random.uniform(size=(solid, 3)).astype(np.float32),
                    **COMPRESSION,
                )
        return path

    return write
