"""Tests of the frames of both sources."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from fluidsnet.errors import UserError
from fluidsnet.export import TrajectoryFile
from fluidsnet.export.frames import Frame, Frames, trajectory_frames
from fluidsnet.studies.export.data_file import data_frames


def test_frames_are_those_of_the_data_file(frames: Frames, sample: Path) -> None:
    with h5py.File(sample / "test.h5") as file:
        group = file["00000"]
        assert len(frames) == 7
        np.testing.assert_array_equal(frames.times, group["time"][10::5])
        for index, frame in zip(range(10, 41, 5), frames, strict=True):
            assert frame.time == group["time"][index]
            assert frame.position.dtype == frame.velocity.dtype == np.float32
            np.testing.assert_array_equal(frame.position, group["position"][index])
            np.testing.assert_array_equal(frame.velocity, group["velocity"][index])
        assert frames.radius() == file.attrs["particle_radius"]
        assert frames.gravity == tuple(file.attrs["gravity"])
    assert frame.ids.tolist() == list(range(330))


def test_big_endian_and_wide_numbers_are_kept() -> None:
    position = np.array([[1e6 + 0.1, 2, 3]], ">f8")
    frame = Frame.of(0.0, position, np.array([[1, 2, 3]], ">f4"))
    assert frame.position.dtype == np.dtype("=f8")
    assert frame.velocity.dtype == np.dtype("=f4")
    np.testing.assert_array_equal(frame.position, position)
    np.testing.assert_array_equal(frame.velocity, [[1, 2, 3]])


@pytest.mark.parametrize(
    ("first", "last", "every", "found"),
    [(0, -1, 1, range(7)), (2, 5, 1, range(2, 6)), (-3, -1, 2, [4, 6]), (6, 6, 9, [6])],
)
def test_a_part_is_selected(
    frames: Frames, first: int, last: int, every: int, found: list[int]
) -> None:
    part = frames.select(first, last, every)
    assert [frame.time for frame in part] == [frames.times[index] for index in found]
    assert list(part.times) == [frames.times[index] for index in found]


@pytest.mark.parametrize(
    ("first", "last", "every", "message"),
    [
        (7, -1, 1, "--first is 7; .* has the frames 0 to 6"),
        (0, -8, 1, "--last is -8"),
        (4, 3, 1, "no frame lies between"),
        (0, -1, 0, "--every is 0"),
    ],
)
def test_frames_that_are_not_there(
    frames: Frames, first: int, last: int, every: int, message: str
) -> None:
    with pytest.raises(UserError, match=message):
        frames.select(first, last, every)


def test_a_trajectory_without_radius_or_velocity(tmp_path: Path) -> None:
    path = tmp_path / "rollout.vtkhdf"
    with TrajectoryFile(path, 2) as file:
        file.append(0.0, np.zeros((2, 3)))
    frames = trajectory_frames(path)
    with pytest.raises(UserError, match="give it with --radius"):
        frames.radius()
    assert replace(frames, particle_radius=0.1).radius() == 0.1
    with pytest.raises(UserError, match="velocity is missing"):
        list(frames)


def test_a_simulation_that_is_not_there(sample: Path) -> None:
    with pytest.raises(UserError, match="there is no simulation 7; the file has 1"):
        data_frames(sample / "test.h5", "7")
