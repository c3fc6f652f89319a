"""Tests of rollout starts and their true states."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from datamodules import SPHDataModule
from fluidsnet.errors import UserError

Write = Callable[..., Path]


@pytest.fixture
def root(write_file: Write) -> Path:
    return write_file("test.h5", (11, 3, 2), (6, 5, 4), seed=2).parent


def data(root: Path, **options: Any) -> SPHDataModule:
    return SPHDataModule(root, voxel_size=0.25, **options)


@pytest.mark.parametrize(
    ("stride", "frames", "steps", "simulations", "expected"),
    [
        (1, (0,), None, None, [("00000", 0, 10), ("00001", 0, 5)]),
        (1, (0,), 7, None, [("00000", 0, 7), ("00001", 0, 5)]),
        (1, (0, 4), 7, None, [("00000", 0, 7), ("00000", 4, 6), ("00001", 0, 5), ("00001", 4, 1)]),
        (1, (0.5,), None, None, [("00000", 5, 5), ("00001", 2, 3)]),
        (2, (0.0, 0.5), None, 1, [("00000", 0, 5), ("00000", 5, 2)]),
    ],
)
def test_starts_by_hand(
    root: Path, stride: int, frames: Any, steps: Any, simulations: Any, expected: Any
) -> None:
    starts = data(root, stride=stride).rollout_starts("test", frames, steps, simulations)
    assert list(zip(starts.names, starts.first, starts.steps, strict=True)) == expected
    assert len(starts) == len(expected)


def test_the_truth_is_the_files_from_the_start_on(root: Path) -> None:
    starts = data(root, stride=2).rollout_starts("test", (3,))
    with h5py.File(root / "test.h5") as file:
        for index, (name, steps) in enumerate((("00000", 3), ("00001", 1))):
            start = starts[index]
            assert (start.name, start.steps, len(start.truth)) == (name, steps, steps + 1)
            assert (start.first, start.known_steps) == (3, steps)
            assert np.array_equal(start.state.position, file[name]["position"][3])
            assert np.array_equal(start.state.solid_position, file[name]["solid_position"])
            assert start.state.scene.time_step == pytest.approx(0.04)
            for step in range(steps + 1):
                position, velocity = start.truth[step]
                assert np.array_equal(position, file[name]["position"][3 + 2 * step])
                assert np.array_equal(velocity, file[name]["velocity"][3 + 2 * step])


@pytest.mark.parametrize("frame", [5, 9, -1, 0.95])
def test_a_start_without_a_step_after_it_is_refused(root: Path, frame: float) -> None:
    with pytest.raises(UserError, match=rf"/0000\d can start at {frame} .*has \d+ frame"):
        data(root).rollout_starts("test", (frame,))
    with pytest.raises(UserError, match=rf"/0000\d can start at {frame} "):
        data(root).rollout_starts("test", (frame,), beyond_truth=True)


@pytest.mark.parametrize(
    ("frames", "steps", "expected"),
    [
        # Simulation, first frame, steps, steps with a true state.
        ((0,), None, [("00000", 0, 10, 10), ("00001", 0, 5, 5)]),
        ((0,), 7, [("00000", 0, 7, 7), ("00001", 0, 7, 5)]),
        ((5,), 3, [("00000", 5, 3, 3), ("00001", 5, 3, 0)]),
    ],
)
def test_beyond_the_truth_a_rollout_keeps_its_steps(
    root: Path, frames: Any, steps: Any, expected: Any
) -> None:
    starts = data(root).rollout_starts("test", frames, steps, beyond_truth=True)
    found = [(start.name, start.first, start.steps, start.known_steps) for start in starts]
    assert found == expected


@pytest.mark.parametrize("frame", [-1, 6])
def test_beyond_the_truth_a_start_still_needs_its_frame(root: Path, frame: int) -> None:
    with pytest.raises(UserError, match=rf"/0000\d can start at {frame} .*has \d+ frame"):
        data(root).rollout_starts("test", (frame,), 3, beyond_truth=True)
