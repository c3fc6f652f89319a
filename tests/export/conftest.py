"""Frames that exports are tested with."""

from __future__ import annotations

from pathlib import Path

import pytest

from fluidsnet.export import TrajectoryFile
from fluidsnet.export.frames import Frames, trajectory_frames
from fluidsnet.studies.export.data_file import data_frames


@pytest.fixture
def simulation(sample: Path) -> Frames:
    """Frames 10, 15, … 40 of a dam break that the real solver made."""
    return data_frames(sample / "test.h5", "00000").select(10, -1, 5)


@pytest.fixture(params=["data file", "trajectory"])
def frames(request: pytest.FixtureRequest, simulation: Frames, tmp_path: Path) -> Frames:
    """The same frames from both sources."""
    if request.param == "data file":
        return simulation
    path = tmp_path / "rollout.vtkhdf"
    attributes = {"particle_radius": simulation.radius(), "gravity": simulation.gravity}
    with TrajectoryFile(path, len(next(iter(simulation)).position), attributes) as file:
        for frame in simulation:
            file.append(frame.time, frame.position, {"velocity": frame.velocity})
    return trajectory_frames(path)
