"""Tests of the lazy reader and its file handles."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import shutil
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from datamodules.reader import FrameReader, read_motion
from datamodules.rollout_starts import HDF5RolloutStarts
from datamodules.transitions import TransitionDataset, samples_in
from fluidsnet.errors import UserError
from fluidsnet.particles import Transitions

Write = Callable[..., Path]


def opened(path: Path) -> int:
    """Return how many descriptors of this process point to a file."""
    folder = Path("/proc/self/fd")
    if not folder.exists():
        pytest.skip("the open files of a process are seen under /proc only")
    links = []
    for descriptor in folder.iterdir():
        try:
            links.append(os.readlink(descriptor))
        except FileNotFoundError:  # the one that listed the folder
            continue
    return links.count(str(path))


def test_the_file_is_opened_at_the_first_read(sample: Path, tmp_path: Path) -> None:
    # Other tests may have the sample itself open.
    path = Path(shutil.copy(sample / "train.h5", tmp_path))
    reader = FrameReader(path)
    assert opened(path) == 0
    reader.fluid("00000", 0)
    reader.fluid("00001", 3)
    assert opened(path) == 1
    reader.close()
    assert opened(path) == 0
    reader.fluid("00000", 1)
    assert opened(path) == 1
    reader.close()


def test_frames_and_states_are_those_of_the_file(sample: Path) -> None:
    path = sample / "train.h5"
    reader = FrameReader(path)
    with h5py.File(path) as file:
        assert dict(reader.frames) == {name: len(file[name]["time"]) for name in sorted(file)}
        for name in file:
            for frame in (0, 7, reader.frames[name] - 1):
                position, velocity = reader.fluid(name, frame)
                np.testing.assert_array_equal(position, file[name]["position"][frame])
                np.testing.assert_array_equal(velocity, file[name]["velocity"][frame])
                state = reader.state(name, frame, stride=1)
                assert torch.equal(state.position, position)
                np.testing.assert_array_equal(
                    state.solid_position, file[name]["solid_position"][()]
                )
                assert not state.solid_velocity.any()
    reader.close()


def test_the_scene_is_the_header_and_steps_by_the_stride(write_file: Write) -> None:
    reader = FrameReader(write_file("train.h5", (3, 5, 2), viscosity=0.03, density0=998.0))
    scene = reader.scene("00000", 4)
    assert scene is reader.scene("00000", 4) and scene.names == ("train/00000",)
    assert scene.time_step == pytest.approx(0.08)
    assert (scene.particle_radius, scene.support_radius) == (0.05, 0.2)
    torch.testing.assert_close(scene.extent, torch.tensor([[1.5, 1.0, 1.5]]))
    torch.testing.assert_close(scene.gravity, torch.tensor([[0.0, -9.81, 0.0]]))


def test_no_handle_is_pickled(sample: Path) -> None:
    path = sample / "train.h5"
    reader = FrameReader(path)
    expected = reader.fluid("00000", 5)
    copy = pickle.loads(pickle.dumps(reader))
    assert opened(path) == 1
    assert all(torch.equal(*pair) for pair in zip(copy.fluid("00000", 5), expected, strict=True))
    reader.close()
    # The copy's handle is its own.
    assert all(torch.equal(*pair) for pair in zip(copy.fluid("00000", 5), expected, strict=True))
    copy.close()


def _read_in_child(reader: FrameReader, inherited: int, pipe: Connection) -> None:
    frames = [reader.fluid("00001", frame)[0].numpy() for frame in range(10)]
    assert reader._handle is not None
    pipe.send((frames, opened(reader.path), reader._handle.id.id == inherited))
    pipe.close()


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_fork_opens_the_file_anew(sample: Path) -> None:
    if "fork" not in multiprocessing.get_all_start_methods():
        pytest.skip("this system does not fork")
    path = sample / "train.h5"
    reader = FrameReader(path)
    reader.fluid("00000", 0)
    assert reader._handle is not None
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    child = context.Process(
        target=_read_in_child, args=(reader, reader._handle.id.id, theirs), daemon=True
    )
    child.start()
    read = [reader.fluid("00002", frame)[0].numpy() for frame in range(10)]
    assert ours.poll(60), "the child says nothing"
    frames, descriptors, same = ours.recv()
    child.join(60)
    assert child.exitcode == 0
    assert descriptors == 1 and not same
    # The parent's handle has outlived the child's.
    read += [reader.fluid("00002", frame)[0].numpy() for frame in range(10, 20)]
    reader.close()
    with h5py.File(path) as file:
        np.testing.assert_array_equal(frames, file["00001/position"][:10])
        np.testing.assert_array_equal(read, file["00002/position"][:20])


@pytest.mark.parametrize("name", ["position", "velocity", "solid_position"])
def test_damage_that_shows_when_read_is_named(write_file: Write, name: str) -> None:
    path = write_file("train.h5", (3, 200, 100))
    with h5py.File(path) as file:
        identity = file["00000"][name].id
        chunk = identity.get_chunk_info(identity.get_num_chunks() - 1)
    with path.open("r+b") as content:
        content.seek(chunk.byte_offset)
        content.write(b"\xff" * chunk.size)
    reader = FrameReader(path)
    with pytest.raises(UserError) as caught:
        reader.state("00000", 2, stride=1)
    words = str(caught.value)
    assert str(path) in words and "/00000" in words and "damaged" in words
    assert ("solids" if name == "solid_position" else "frame 2") in words
    reader.close()


def test_a_file_that_is_gone_is_named(write_file: Write) -> None:
    path = write_file("train.h5", (3, 5, 2))
    reader = FrameReader(path)
    path.unlink()
    with pytest.raises(UserError, match="gone"):
        reader.fluid("00000", 0)


def test_solids_that_move_are_read_with_their_frame(write_file: Write) -> None:
    path = write_file("test.h5", (4, 2, 3), (4, 2, 5))
    random = np.random.default_rng(1)
    with h5py.File(path, "r+") as file:
        group = file["00000"]
        del group["solid_position"]
        for name in ("solid_position", "solid_velocity"):
            group[name] = random.uniform(size=(4, 3, 3)).astype(np.float32)
        expected = group["solid_position"][...], group["solid_velocity"][...]
    reader = FrameReader(path)
    state = reader.state("00000", 2, 1)
    assert state.solids_move and not reader.state("00001", 2, 1).solids_move
    np.testing.assert_array_equal(state.solid_position, expected[0][2])
    np.testing.assert_array_equal(state.solid_velocity, expected[1][2])
    motion = read_motion(path, 0.02, frame=1)
    assert motion is not None and read_motion(path, 0.02, simulation="00001") is None
    np.testing.assert_array_equal(motion[2][0], expected[0][3])
    with pytest.raises(UserError, match=r"solids of /00000 move, and their motion is known for 4"):
        motion[3]
    starts = HDF5RolloutStarts(reader, 1, steps=3, beyond_truth=True)
    assert starts[0].solids is not None and starts[1].solids is None
    with pytest.raises(UserError, match=r"known for 3 steps; set data.rollout_steps to 3 or"):
        HDF5RolloutStarts(reader, 1, steps=4, beyond_truth=True)
    samples = samples_in([reader], 2, (0, None), 1)
    dataset = TransitionDataset(samples, 1, 2)
    both = Transitions.collate([dataset[0], dataset[len(samples) - 1]])
    assert both.solids is not None and both.state.solids_move
    assert both.solids.position.shape == (2, 8, 3)
    np.testing.assert_array_equal(both.solids[1][0][:3], expected[0][1])
    assert not both.solids.velocity[:, 3:].any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"periodic": [(False,) * 3, (True, False, False)]}, "some simulations have periodic axes"),
    ],
)
def test_scenes_that_cannot_be_stepped_are_refused(
    write_file: Write, change: dict[str, Any], words: str
) -> None:
    path = write_file("train.h5", (3, 5, 2), (3, 5, 2), **change)
    with pytest.raises(UserError, match=f"train.h5: {words}"):
        FrameReader(path)
