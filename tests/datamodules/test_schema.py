"""Tests of the file format and its error messages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from datamodules.schema import (
    SCHEMA_VERSION,
    Header,
    SceneAttributes,
    create_frames,
    open_valid,
    simulations,
    validate,
)
from fluidsnet.errors import UserError

Write = Callable[..., Path]
Spoil = Callable[[h5py.File], None]


def sentence(path: Path) -> str:
    """Return the error message of an invalid file: one sentence that names the file."""
    with pytest.raises(UserError) as caught:
        validate(path)
    words = str(caught.value)
    assert words.startswith(f"{path}: ") and words.endswith(".")
    assert "\n" not in words
    return words.removeprefix(f"{path}: ")


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_the_sample_is_valid(sample: Path, split: str) -> None:
    validate(sample / f"{split}.h5")


def test_a_missing_file_says_how_to_make_one(tmp_path: Path) -> None:
    assert "fluidsnet generate" in sentence(tmp_path / "train.h5")


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    assert "it is a folder, a pipe or a device" in sentence(tmp_path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_truncated_file(write_file: Write, share: float) -> None:
    path = write_file("train.h5", (4, 300, 20))
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert "not a whole HDF5 file" in sentence(path)


def test_a_text_file(tmp_path: Path) -> None:
    path = tmp_path / "train.h5"
    path.write_text("position velocity\n" * 1000)
    assert "not a whole HDF5 file" in sentence(path)


def test_a_foreign_hdf5_file(tmp_path: Path) -> None:
    path = tmp_path / "train.h5"
    with h5py.File(path, "w") as file:
        file["VTKHDF/Points"] = np.zeros((5, 3))
    assert "not a FluidsNet data file" in sentence(path)


def drop_attribute(name: str) -> Spoil:
    return lambda file: file.attrs.__delitem__(name)


def set_attribute(name: str, value: object) -> Spoil:
    return lambda file: file.attrs.__setitem__(name, value)


def drop_scene(name: str) -> Spoil:
    return lambda file: file["00000"].attrs.__delitem__(name)


def set_scene(name: str, value: object) -> Spoil:
    return lambda file: file["00000"].attrs.__setitem__(name, value)


def drop(name: str) -> Spoil:
    return lambda file: file.__delitem__(name)


def put(name: str, values: object) -> Spoil:
    def spoil(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = values

    return spoil


def group_for(name: str) -> Spoil:
    def spoil(file: h5py.File) -> None:
        del file[name]
        file.create_group(name)

    return spoil


#: What is spoiled, and words that must be in the sentence. A valid file has 4 frames of 6.
SPOILED: dict[str, tuple[Spoil, list[str]]] = {
    "another version": (
        set_attribute("schema_version", 3),
        ["schema_version is 3", "reads 1 and 2"],
    ),
    "a version in words": (set_attribute("schema_version", "two"), ["schema_version is two"]),
    "no dt": (drop_attribute("dt"), ["attribute dt is missing"]),
    "no solver": (drop_attribute("solver"), ["attribute solver is missing"]),
    "gravity a number": (set_scene("gravity", -9.81), ["/00000", "gravity", "three numbers"]),
    "gravity in words": (set_scene("gravity", "down"), ["gravity", "numbers"]),
    "gravity not finite": (set_scene("gravity", [0, np.nan, 0]), ["gravity", "finite"]),
    "no gravity": (drop_scene("gravity"), ["/00000", "gravity is missing", "or on the file"]),
    "periodic in words": (set_scene("periodic", "xyz"), ["periodic", "three booleans"]),
    "four dimensions": (set_scene("dimension", 4), ["dimension is 4", "2 or 3"]),
    "dt in words": (set_attribute("dt", "20 ms"), ["dt", "number"]),
    "dt zero": (set_attribute("dt", 0.0), ["dt", "above zero"]),
    "dt three numbers": (set_attribute("dt", np.ones(3)), ["dt", "one number"]),
    "radius not a number": (set_attribute("particle_radius", np.nan), ["radius", "above zero"]),
    "radius of nothing": (
        set_attribute("particle_radius", 1e-300),
        ["radius is 1e-300", "between"],
    ),
    "viscosity beyond": (set_scene("viscosity", 1e300), ["/00000", "viscosity is 1e+300"]),
    "parameters no JSON": (set_attribute("solver_parameters", "{"), ["solver_parameters", "JSON"]),
    "flat domain": (
        set_scene("domain_upper", np.array([1.5, 0.0, 1.5])),
        ["/00000", "domain_upper must be above domain_lower"],
    ),
    "no simulation": (drop("00000"), ["no simulation", "/00000"]),
    "no position": (drop("00000/position"), ["/00000", "position is missing"]),
    "no velocity": (drop("00000/velocity"), ["/00000", "velocity is missing"]),
    "no time": (drop("00000/time"), ["/00000", "time is missing"]),
    "no seconds": (drop("00000/solver_seconds"), ["/00000", "solver_seconds is missing"]),
    "no solids": (drop("00000/solid_position"), ["/00000", "solid_position is missing"]),
    "a group for a data set": (group_for("00000/time"), ["/00000", "time is missing"]),
    "flat position": (put("00000/position", np.zeros((4, 18))), ["/00000/position", "(T, N, 3)"]),
    "two axes": (put("00000/position", np.zeros((4, 6, 2))), ["/00000/position", "(T, N, 3)"]),
    "zero frames": (put("00000/position", np.zeros((0, 6, 3))), ["/00000/position", "one frame"]),
    "zero particles": (put("00000/position", np.zeros((4, 0, 3))), ["/00000", "one particle"]),
    "velocity too short": (
        put("00000/velocity", np.zeros((3, 6, 3))),
        ["/00000/velocity", "(3, 6, 3)", "(4, 6, 3)"],
    ),
    "time too long": (put("00000/time", np.zeros(5)), ["/00000/time", "(5,)", "(4,)"]),
    "whole numbers": (
        put("00000/position", np.zeros((4, 6, 3), dtype=np.int32)),
        ["/00000/position", "int32", "floating-point"],
    ),
    "bytes": (put("00000/time", np.array([b"a"] * 4)), ["/00000/time", "floating-point"]),
    "flat solids": (
        put("00000/solid_position", np.zeros(6)),
        ["/00000/solid_position", "(M, 3) or (T, M, 3)"],
    ),
    "moving solids, other frames": (
        put("00000/solid_position", np.zeros((3, 2, 3))),
        ["/00000/solid_position", "(4, 2, 3)"],
    ),
    "moving solids without velocity": (
        put("00000/solid_position", np.zeros((4, 2, 3))),
        ["/00000", "solid_velocity is missing"],
    ),
}


@pytest.mark.parametrize("case", SPOILED)
def test_what_is_wrong_is_named(write_file: Write, case: str) -> None:
    spoil, expected = SPOILED[case]
    path = write_file("train.h5", (4, 6, 2))
    validate(path)
    with h5py.File(path, "a") as file:
        spoil(file)
    words = sentence(path)
    for word in expected:
        assert word in words


def test_the_second_simulation_is_looked_at_too(write_file: Write) -> None:
    path = write_file("train.h5", (4, 6, 2), (4, 5, 2))
    with h5py.File(path, "a") as file:
        del file["00001/time"]
    assert "/00001" in sentence(path)


def test_solids_that_move_are_valid(write_file: Write) -> None:
    path = write_file("train.h5", (4, 6, 2))
    with h5py.File(path, "a") as file:
        put("00000/solid_position", np.zeros((4, 2, 3)))(file)
        put("00000/solid_velocity", np.zeros((4, 2, 3)))(file)
    validate(path)


def test_an_open_file_is_a_valid_one(write_file: Write) -> None:
    path = write_file("train.h5", (4, 6, 2))
    with open_valid(path) as file:
        assert file.mode == "r"
    path.write_bytes(b"")
    with pytest.raises(UserError):
        open_valid(path)


def test_a_header_comes_back_as_it_was(tmp_path: Path) -> None:
    header = Header(
        scene="DropPool",
        solver="DFSPH",
        solver_version="2.19.0",
        solver_parameters={"maxError": 0.05, "steps": [1, 2], "name": "ü"},
        particle_radius=0.1 + 0.2,
        support_radius=1.2,
        dt=1e-3,
    )
    with h5py.File(tmp_path / "header.h5", "w") as file:
        header.write(file)
        assert file.attrs["schema_version"] == SCHEMA_VERSION
        assert Header.read(file) == header


def test_a_scene_comes_back_as_it_was(tmp_path: Path) -> None:
    scene = SceneAttributes(
        domain_lower=(-0.1, 0.0, 0.3),
        domain_upper=(1.0 / 3.0, 1.0, 2.0),
        gravity=(0.0, -9.81, 0.0),
        density0=998.2,
        viscosity=0.01,
        surface_tension=0.2,
        periodic=(True, False, True),
        dimension=2,
    )
    with h5py.File(tmp_path / "scene.h5", "w") as file:
        group = file.create_group("00000")
        scene.write(group)
        assert group.attrs["domain_upper"].dtype == np.float64
        assert group.attrs["periodic"].dtype == np.bool_
        assert SceneAttributes.read(group) == scene


def test_the_simulations_attributes_win_over_the_files(write_file: Write) -> None:
    path = write_file("train.h5", (4, 6, 2), (4, 6, 2))
    with h5py.File(path, "a") as file:
        file.attrs["gravity"], file.attrs["viscosity"] = [0.0, 0.0, -1.6], 0.5
        del file["00001"].attrs["gravity"]
        own, of_file = (SceneAttributes.read(file[name]) for name in ("00000", "00001"))
    assert own.gravity == (0.0, -9.81, 0.0) and own.viscosity == of_file.viscosity == 0.01
    assert of_file.gravity == (0.0, 0.0, -1.6)
    validate(path)


def test_other_groups_and_attributes_are_ignored(write_file: Write) -> None:
    path = write_file("train.h5", (4, 6, 2))
    with h5py.File(path, "a") as file:
        file["analysis/table"], file.attrs["author"] = np.zeros(3), "me"
        assert simulations(file) == ["00000"]
    validate(path)


def test_one_frame_a_chunk_with_filters_that_every_h5py_reads(sample: Path, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "made.h5", "w") as made, h5py.File(sample / "train.h5") as file:
        for group, particles in ((made, 7), (file["00000"], None)):
            if particles is not None:
                create_frames(group, particles)
            for name in ("position", "velocity"):
                dataset = group[name]
                assert dataset.chunks == (1, *dataset.shape[1:])
                assert dataset.dtype == np.float32
                assert dataset.compression == "gzip" and dataset.shuffle
