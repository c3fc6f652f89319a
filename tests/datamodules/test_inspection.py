"""Tests of `fluidsnet inspect` on valid and on damaged files."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from datamodules.inspection import summarize
from fluidsnet.errors import UserError
from fluidsnet.studies.plan.command import inspect_command

Spoil = Callable[[h5py.File], None]


@pytest.fixture
def copy(sample: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(sample / "train.h5", tmp_path / "train.h5"))


Write = Callable[..., Path]


def row(text: str, name: str) -> list[str]:
    """Return the columns of a simulation in a summary."""
    (line,) = [line for line in text.splitlines() if line.split()[:1] == [name]]
    return line.split()


def test_a_report_says_what_the_file_holds(sample: Path) -> None:
    text = summarize(sample / "train.h5").text
    with h5py.File(sample / "train.h5") as file:
        assert f"{len(file)} simulation(s)" in text
        for name, group in file.items():
            frames, fluid, _ = group["position"].shape
            columns = row(text, name)
            assert columns[1:5] == [
                str(frames),
                f"{group['time'][-1]:.3f}",
                str(fluid),
                str(len(group["solid_position"])),
            ]
            fastest = np.linalg.norm(group["velocity"][()], axis=-1).max()
            assert float(columns[5]) == pytest.approx(fastest, abs=0.006)
            cost = group["solver_seconds"][()].sum() / group["time"][-1]
            assert float(columns[6]) == pytest.approx(cost, abs=0.06)
            assert columns[7] == f"({group.attrs['threads']})"
        lower = np.min([group["position"][()].min(axis=(0, 1)) for group in file.values()], axis=0)
    assert ", ".join(f"{value:.3f}" for value in lower) in text
    assert re.search(r"scene +DamBreak\n", text)
    assert re.search(r"domain +1.5 x 1 x 1.5 m\n", text)
    assert re.search(r"solver +IISPH, version \d", text)
    assert "20 ms" in text and "MB" in text


def test_a_report_shows_what_differs_between_simulations(write_file: Write) -> None:
    path = write_file(
        "train.h5",
        (3, 4, 2),
        (3, 5, 2),
        domain_upper=[(2.0, 2.0, 2.0), (3.5, 2.0, 2.0)],
        viscosity=[0.01, 0.5],
        surface_tension=[0.0, 0.25],
    )
    text = summarize(path).text
    assert re.search(r"gravity +0, -9.81, 0 m/s²\n", text)
    assert not re.search(r"^  (domain|viscosity|surface tension)", text, re.MULTILINE)
    assert "periodic" not in text and "dimension" not in text
    table = text.split("\n\n")[1]
    head, first, second = table.splitlines()
    for words, line in (
        (("domain", "viscosity", "surface tension"), head),
        (("2 x 2 x 2 m", "0.01", "0"), first),
        (("3.5 x 2 x 2 m", "0.5", "0.25"), second),
    ):
        places = [line.rfind(word) for word in words]
        assert -1 < places[0] < places[1] < places[2]


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_nothing_in_the_sample_is_suspicious(sample: Path, split: str) -> None:
    text = summarize(sample / f"{split}.h5").text
    assert text.endswith("nothing suspicious")
    assert "suspicious:" not in text


def not_finite(file: h5py.File) -> None:
    file["00001/velocity"][7, 3, 1] = np.nan
    file["00001/position"][9, 0, 0] = np.inf


def shuffled(file: h5py.File) -> None:
    random = np.random.default_rng(0)
    for name in ("position", "velocity"):
        frames = file["00001"][name][()]
        order = random.permutation(frames.shape[1])
        frames[20:] = frames[20:, order]
        file["00001"][name][...] = frames


def escaped(file: h5py.File) -> None:
    file["00001/position"][12:, 5, 2] = 1.7


def other_dt(file: h5py.File) -> None:
    file.attrs["dt"] = 0.04


def uneven(file: h5py.File) -> None:
    file["00001/time"][5] += 0.004


def still(file: h5py.File) -> None:
    file["00001/velocity"][...] = 0
    file["00001/position"][...] = file["00001/position"][0]


def zero(file: h5py.File) -> None:
    file["00001/position"][8] = 0


def twice(file: h5py.File) -> None:
    file["00001/position"][11] = file["00001/position"][10]


def wrapped(file: h5py.File) -> None:
    file["00001/position"][9:, :, 0] = (file["00001/position"][9:, :, 0] + 1.3) % 1.5


def chunked(file: h5py.File) -> None:
    values = file["00001/position"][()]
    del file["00001/position"]
    file["00001"].create_dataset("position", data=values, chunks=(5, *values.shape[1:]))


def solids_in_mm(file: h5py.File) -> None:
    file["00001/solid_position"][...] *= 1000


def solids_twice(file: h5py.File) -> None:
    solids = file["00001/solid_position"]
    solids[len(solids) // 2 :] = solids[0]


SPOILED: dict[str, tuple[Spoil, str]] = {
    "not finite": (not_finite, r"2 frames are not finite, or beyond 1e\+30, the first is 7"),
    "shuffled rows": (shuffled, "rows may not keep their particle"),
    "escaped": (escaped, "up to 1 particles are outside the domain"),
    "another dt": (other_dt, "the frames are not dt apart"),
    "uneven time": (uneven, "the frames are not dt apart"),
    "still": (still, "nothing moves"),
    "zero": (zero, "1 frames are all zero, the first is 8"),
    "twice": (twice, "1 frames are the same as the one before though the fluid moves.* is 11"),
    "wrapped": (wrapped, r"cross the whole box within a frame, first in \d+: positions may be"),
    "chunked": (chunked, "a chunk of positions holds 5 frames"),
    "solids in mm": (solids_in_mm, "solids are farther from the domain than it is wide"),
    "solids twice": (solids_twice, r"\d+ solids are at the place of another"),
}


@pytest.mark.parametrize("case", SPOILED)
def test_what_is_suspicious_is_found_where_it_is(copy: Path, case: str) -> None:
    spoil, expected = SPOILED[case]
    with h5py.File(copy, "a") as file:
        spoil(file)
    # Below the table: what is damaged, and what is suspicious.
    suspicions = summarize(copy).text.partition("fluid lies between")[2]
    assert re.search(rf"/00001: .*{expected}", suspicions)
    if case != "another dt":  # the one that concerns the whole file
        assert "/00000" not in suspicions and "/00002" not in suspicions


def test_velocities_of_another_unit_are_suspicious(copy: Path) -> None:
    with h5py.File(copy, "a") as file:
        for group in file.values():
            group["velocity"][...] *= 100
    assert "positions and velocities disagree" in summarize(copy).text


def test_a_frame_that_cannot_be_read_is_named(copy: Path) -> None:
    with h5py.File(copy) as file:
        chunk = file["00002/velocity"].id.get_chunk_info(4)
    with copy.open("r+b") as content:
        content.seek(chunk.byte_offset)
        content.write(b"\xff" * chunk.size)
    with pytest.raises(UserError, match=r"train\.h5: .*damaged"):
        summarize(copy)


@pytest.mark.parametrize("error", [OSError, KeyError, RuntimeError])
def test_whatever_h5py_raises_is_damage(
    copy: Path, error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(self: h5py.Dataset, index: object) -> None:
        raise error("a bad sector")

    monkeypatch.setattr(h5py.Dataset, "__getitem__", fails)
    with pytest.raises(UserError, match=r"train\.h5: .*damaged .*a bad sector"):
        summarize(copy)


def test_what_only_the_generator_writes_may_be_missing(copy: Path) -> None:
    with h5py.File(copy, "a") as file:
        for group in file.values():
            for name in ("seed", "scene_parameters", "threads"):
                del group.attrs[name]
    text = summarize(copy).text
    assert row(text, "00000")[7] == "(?)"
    assert text.endswith("nothing suspicious")


def test_several_files_make_several_pages(sample: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inspect_command([str(sample / "train.h5"), str(sample / "val.h5")])
    out = capsys.readouterr().out
    assert f"{sample / 'train.h5'}: " in out and f"{sample / 'val.h5'}: " in out


def test_a_bad_file_is_one_sentence_and_status_1(tmp_path: Path) -> None:
    path = tmp_path / "bad.h5"
    path.write_text("no data")
    run = subprocess.run(
        [sys.executable, "-m", "fluidsnet.main", "inspect", str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 1
    assert run.stdout == ""
    assert len(run.stderr.strip().splitlines()) == 1
    assert run.stderr.startswith(f"fluidsnet: {path}: not a whole HDF5 file")


def test_a_folder_is_all_of_its_files(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inspect_command([str(sample)])
    text = capsys.readouterr().out
    assert [f"{sample / name}.h5: " in text for name in ("train", "val", "test")] == [True] * 3
    with pytest.raises(UserError, match=r"holds none of train.h5, val.h5 and test.h5"):
        inspect_command([str(tmp_path)])
