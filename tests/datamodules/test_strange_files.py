"""Data files that another program wrote, holds, or filled with names meant for a terminal."""

from __future__ import annotations

import multiprocessing
import os
import re
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
import pytest

from datamodules.inspection import summarize
from datamodules.reader import FrameReader
from datamodules.schema import validate
from fluidsnet.errors import UserError

Change = Callable[[h5py.File], None]
#: Number of a filter that nobody registered.
UNKNOWN = 511


@pytest.fixture
def file(sample: Path, tmp_path: Path) -> Path:
    shutil.copy(sample / "test.h5", tmp_path / "test.h5")
    return tmp_path / "test.h5"


def changed(file: Path, change: Change) -> Path:
    with h5py.File(file, "r+") as handle:
        change(handle)
    return file


def unknown_filter(handle: h5py.File) -> None:
    group = handle["00000"]
    shape = group["velocity"].shape
    del group["velocity"]
    settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    settings.set_chunk((1, *shape[1:]))
    settings.set_filter(UNKNOWN, h5py.h5z.FLAG_OPTIONAL, ())
    space = h5py.h5s.create_simple(shape)
    stored = h5py.h5d.create(group.id, b"velocity", h5py.h5t.IEEE_F32LE, space, settings)
    for frame in range(shape[0]):
        stored.write_direct_chunk((frame, 0, 0), bytes(100))


def test_a_filter_that_is_not_installed_is_named_with_its_package(file: Path) -> None:
    words = f"/00000/velocity is compressed with the HDF5 filter {UNKNOWN}, .*install hdf5plugin`"
    with pytest.raises(UserError, match=words):
        validate(changed(file, unknown_filter))


def test_a_filter_of_hdf5plugin_is_read(file: Path) -> None:
    before = FrameReader(file).fluid("00000", 3)[0]

    def zstandard(handle: h5py.File) -> None:
        position = handle["00000/position"][()]
        del handle["00000/position"]
        handle["00000"].create_dataset(
            "position", data=position, chunks=(1, *position.shape[1:]), **hdf5plugin.Zstd()
        )

    assert (FrameReader(changed(file, zstandard)).fluid("00000", 3)[0] == before).all()


def hold(path: Path, opened: multiprocessing.synchronize.Event) -> None:
    with h5py.File(path, "r+"):
        opened.set()
        signal.pause()


def test_a_file_that_another_process_writes_is_called_locked(file: Path) -> None:
    context = multiprocessing.get_context("spawn")
    opened = context.Event()
    writer = context.Process(target=hold, args=(file, opened), daemon=True)
    writer.start()
    assert opened.wait(60)
    with pytest.raises(UserError, match=r"has locked it, .*wait until it is closed there"):
        validate(file)
    writer.kill()
    writer.join()
    validate(file)


def killed_writer(path: Path) -> None:
    handle = h5py.File(path, "w", libver="latest")
    handle["x"] = 1
    handle.flush()
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_file_whose_writer_was_killed_is_said_to_be_unlocked_by_h5clear(tmp_path: Path) -> None:
    path = tmp_path / "test.h5"
    writer = multiprocessing.get_context("spawn").Process(target=killed_writer, args=(path,))
    writer.start()
    writer.join()
    with pytest.raises(UserError, match=f"unlock it with `h5clear -s {path}`"):
        validate(path)


def test_a_pipe_and_a_device_are_no_data_files(tmp_path: Path) -> None:
    pipe = tmp_path / "train.h5"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), tmp_path):
        with pytest.raises(UserError, match="a folder, a pipe or a device, and no data file"):
            validate(path)


def external(handle: h5py.File) -> None:
    shape = handle["00000/velocity"].shape
    del handle["00000/velocity"]
    handle["00000"].create_dataset(
        "velocity", shape, "f4", external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
    )


def looping(handle: h5py.File) -> None:
    handle["00001"] = h5py.SoftLink("/00001")


def titled(handle: h5py.File) -> None:
    handle["\x1b]0;title\x07"] = handle["00000"]


def long(handle: h5py.File) -> None:
    handle["a" * 300] = handle["00000"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (external, "/00000/velocity takes its values from another file"),
        (looping, "the file is damaged: .*too many links"),
        (titled, r"the group '\\x1b]0;title\\x07' must have a name of at most 100 printable"),
        (long, "must have a name of at most 100 printable characters"),
    ],
)
def test_what_a_file_may_not_have(file: Path, change: Change, message: str) -> None:
    with pytest.raises(UserError, match=message):
        validate(changed(file, change))


def test_texts_of_a_file_reach_no_terminal_as_control_characters(file: Path) -> None:
    def obeyed(handle: h5py.File) -> None:
        handle.attrs["scene"] = handle.attrs["solver"] = "\x1b[2Jgone"
        handle["00000"].attrs["threads"] = "\x1b[2J"

    text = summarize(changed(file, obeyed)).text
    assert "\x1b" not in text and r"\x1b[2Jgone" in text


def test_other_groups_are_ignored_whatever_they_hold(file: Path) -> None:
    def more(handle: h5py.File) -> None:
        handle["notes/x"] = 1
        handle.create_group("pictures/position")
        handle["00000/mine"] = 2.0

    assert list(FrameReader(changed(file, more)).frames) == ["00000"]


def swapped(handle: h5py.File) -> None:
    for name in ("position", "velocity", "solid_position"):
        stored = handle[f"00000/{name}"]
        stored[...] = stored[()][..., [0, 2, 1]]
    for owner in (handle, handle["00000"]):
        if "domain_upper" in owner.attrs:
            owner.attrs["domain_upper"] = owner.attrs["domain_upper"][[0, 2, 1]]


def test_axes_that_are_swapped_are_suspicious(file: Path) -> None:
    text = summarize(changed(file, swapped)).text
    assert re.search(r"without falling along gravity, \(0, -9.81, 0\) m/s²: .* -z, so axes", text)


def test_solids_outside_the_domain_are_counted(file: Path) -> None:
    def raised(handle: h5py.File) -> None:
        solids = handle["00000/solid_position"]
        values = solids[()]
        values[:3] = [[-1.0, 0.1, 0.1], [-1.0, 0.2, 0.1], [-1.0, 0.3, 0.1]]
        solids[...] = values

    text = summarize(changed(file, raised)).text
    assert "3 of 1510 solids are more than a support radius outside the domain" in text


def zero(handle: h5py.File) -> None:
    handle["00000/position"][5] = 0


@pytest.mark.parametrize(
    ("change", "told", "refused"),
    [
        (zero, "1 frames are all zero, the first is 5", "frame 5 of /00000 is all zero"),
    ],
)
def test_what_inspect_calls_damaged_is_not_read(
    file: Path, change: Change, told: str, refused: str
) -> None:
    before = FrameReader(file).fluid("00000", 4)
    _, _, damaged = summarize(changed(file, change)).text.partition("damaged, and refused")
    assert told in damaged
    reader = FrameReader(file)
    assert (reader.fluid("00000", 4)[0] == before[0]).all()
    with pytest.raises(UserError, match=refused):
        reader.fluid("00000", 5)


def test_fluid_at_rest_is_not_taken_for_a_frame_stored_twice(file: Path) -> None:
    def resting(handle: h5py.File) -> None:
        position, velocity = (handle[f"00000/{name}"] for name in ("position", "velocity"))
        position[...] = np.broadcast_to(position[0], position.shape)
        velocity[...] = 1e-4

    changed(file, resting)
    assert "the same as the one before" not in summarize(file).text
