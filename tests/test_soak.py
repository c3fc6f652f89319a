"""Damaged data files: some of those that `make soak` tries."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

import datamodules.guard
from datamodules.guard import guarded
from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from tools.soak import FAULTS, soak
from tools.soak_runs import soak_runs


def test_no_damaged_file_is_let_in_or_breaks_the_program(tmp_path: Path) -> None:
    counts = soak(seconds=300, most=60, seed=7, keep=tmp_path)
    assert sum(counts.values()) == 60
    assert {fault: counts[fault] for fault in FAULTS} == dict.fromkeys(FAULTS, 0)
    # Of both kinds, or the mutations do nothing, or all of them the same.
    assert counts["refused"] > 15 and counts["harmless"] > 5


def test_a_loop_in_a_file_ends_with_its_name(
    sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = bytearray((sample / "val.h5").read_bytes())
    # Found by `make soak`: HDF5 reads on for ever.
    content[4270:4270] = content[4270:4278]
    path = tmp_path / "loop.h5"
    path.write_bytes(content)
    monkeypatch.setattr(datamodules.guard, "LIMIT", 2.0)
    with pytest.raises(UserError, match=r"loop.h5: opening it takes more than 2 s, so its"):
        FrameReader(path)


def test_a_type_of_number_that_numpy_has_not_is_damage(sample: Path, tmp_path: Path) -> None:
    content = bytearray((sample / "val.h5").read_bytes())
    # Found by `make soak`: a float whose exponent is elsewhere.
    content[1763] = 2
    path = tmp_path / "float.h5"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"float.h5: the file is damaged: Insufficient precision"):
        FrameReader(path)


def test_a_crash_of_the_library_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="the file is damaged: HDF5 crashes when it opens it"):
        guarded(tmp_path / "x.h5", lambda: os.kill(os.getpid(), signal.SIGSEGV))
    guarded(tmp_path / "x.h5", lambda: 1 / 0)


def test_killed_trainings_and_full_disks_leave_whole_files() -> None:
    counts = soak_runs(seconds=0, seed=1)
    # Only root may mount a small disk.
    assert sum(counts.values()) in (1, 2)
    assert not {fault: count for fault, count in counts.items() if fault in FAULTS}
