"""Tests of `fluidsnet convert` from and to LagrangeBench's format."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from datamodules.convert.command import convert_command
from datamodules.inspection import summarize
from datamodules.schema import Header, SceneAttributes, create_frames, simulations
from fluidsnet.errors import UserError

Write = Callable[..., Path]

#: Rows of a file with all types that are read: their order is mixed.
TYPES = np.array([1, 0, -1, 0, 2, 0, 1, -1])
METADATA: dict[str, Any] = {
    "case": "CAVITY",
    "solver": "SPH",
    "dim": 2,
    "dx": 0.1,
    "dt": 0.001,
    "write_every": 20,
    "viscosity": 0.02,
    "num_particles_max": 8,
    "periodic_boundary_conditions": [True, False],
    "bounds": [[0.0, 2.0], [0.0, 1.0]],
    "default_connectivity_radius": 0.145,
}


@pytest.fixture
def lennard_jones() -> Path:
    """LagrangeBench's own test set."""
    return Path(__file__).parents[1] / "data" / "lagrangebench_3D_LJ"


@pytest.fixture
def write_cavity(tmp_path: Path) -> Write:
    """Writes a data set of two simulations with walls, moving walls and padding."""

    def write(types: np.ndarray[Any, Any] = TYPES, **changes: Any) -> Path:
        folder = tmp_path / "cavity"
        folder.mkdir()
        metadata = {key: it for key, it in {**METADATA, **changes}.items() if it is not None}
        (folder / "metadata.json").write_text(json.dumps(metadata))
        dimension = metadata["dim"]
        random = np.random.default_rng(0)
        with h5py.File(folder / "valid.h5", "w") as file:
            for name in ("00000", "00001"):
                start = random.uniform(0.2, 0.8, (len(types), dimension))
                steps = np.zeros((9, len(types), dimension))
                steps[:, types == 0] = random.normal(0, 0.01, steps[:, types == 0].shape)
                # The lid moves with 3 m/s, over the periodic edge.
                steps[:, types == 2, 0] = 3 * 0.02
                position = np.concatenate([start[None], start + steps.cumsum(axis=0)])
                position[..., 0] %= 2.0
                position[:, types == -1] = 0
                file[f"{name}/particle_type"] = types
                file.create_dataset(
                    f"{name}/position", data=position.astype(np.float32), compression="gzip"
                )
        return folder

    return write


def convert(*arguments: object) -> None:
    convert_command([str(argument) for argument in arguments])


def test_real_files_are_read_with_their_periods(lennard_jones: Path, tmp_path: Path) -> None:
    convert(lennard_jones, "--root", tmp_path / "out", "--viscosity", 0)
    for ours, theirs in (("train", "train"), ("val", "valid"), ("test", "test")):
        with (
            h5py.File(tmp_path / "out" / f"{ours}.h5") as file,
            h5py.File(lennard_jones / f"{theirs}.h5") as source,
        ):
            scene = SceneAttributes.read(file["00000"])
            assert scene.periodic == (True, True, True)
            assert scene.domain_upper == (5, 5, 5)
            position, velocity = file["00000/position"][()], file["00000/velocity"][()]
            assert np.array_equal(position, source["00000/position"][()])
            header = Header.read(file)
            assert (header.dt, header.particle_radius) == (0.005, 0.7)
            assert header.support_radius == pytest.approx(2.8)
        # Symplectic Euler with the velocities is exact, up to whole boxes.
        missed = (position[1:] - position[:-1] - 0.005 * velocity[1:]) / 5
        assert np.abs(missed - np.round(missed)).max() < 1e-6
        assert np.abs(velocity).max() < 10  # one box in a frame is 1,000 m/s
        assert np.array_equal(velocity[0], velocity[1])
    assert "periodic         x, y, z" in summarize(tmp_path / "out" / "train.h5").text


def test_walls_move_and_padding_goes(write_cavity: Write, tmp_path: Path) -> None:
    folder = write_cavity()
    convert(folder, "--root", tmp_path / "out")
    with (
        h5py.File(tmp_path / "out" / "val.h5") as file,
        h5py.File(folder / "valid.h5") as source,
    ):
        assert Header.read(file).dt == pytest.approx(0.02)
        assert simulations(file) == ["00000", "00001"]
        group, position = file["00001"], source["00001/position"][()]
        scene = SceneAttributes.read(group)
        assert (scene.dimension, scene.viscosity, scene.density0) == (2, 0.02, 1)
        assert scene.periodic == (True, False, False)
        assert scene.domain_lower[:2] == (0, 0) and scene.domain_upper[:2] == (2, 1)
        assert np.array_equal(group["position"][..., :2], position[:, TYPES == 0])
        assert not group["position"][..., 2].any()
        solid = np.isin(TYPES, (1, 2))
        assert np.array_equal(group["solid_position"][..., :2], position[:, solid])
        speed = np.zeros((10, 3, 3))
        speed[:, 1, 0] = 3
        assert np.allclose(group["solid_velocity"], speed, atol=1e-3)
    assert "dimension        2" in summarize(tmp_path / "out" / "val.h5").text


def test_walls_at_rest_are_stored_once(write_cavity: Write, tmp_path: Path) -> None:
    folder = write_cavity(np.array([0, 1, 0, 1]))
    convert(folder, "--root", tmp_path / "out")
    with h5py.File(tmp_path / "out" / "val.h5") as file:
        assert file["00000/solid_position"].shape == (2, 3)
        assert "solid_velocity" not in file["00000"]


def test_three_dimensions_and_options(write_cavity: Write, tmp_path: Path) -> None:
    folder = write_cavity(
        dim=3, bounds=[[0, 2], [0, 1], [0, 1]], periodic_boundary_conditions=[False] * 3
    )
    convert(
        *(folder, "--root", tmp_path / "out", "--gravity", 0, -1, 0, "--viscosity", 0.5),
        *("--density0", 7, "--domain", -1, -1, -1, 3, 3, 3, "--particle-radius", 0.04),
        *("--dt", 0.1),
    )
    with h5py.File(tmp_path / "out" / "val.h5") as file:
        scene, header = SceneAttributes.read(file["00000"]), Header.read(file)
    assert scene == SceneAttributes((-1, -1, -1), (3, 3, 3), (0, -1, 0), 7, 0.5)
    assert (header.particle_radius, header.dt) == (0.04, 0.1)


@pytest.mark.parametrize(
    ("types", "changes", "words"),
    [
        (np.array([0, 3]), {}, "00000: 1 of its particles are of rigid bodies"),
        (np.array([0, 5]), {}, r"particle_type has the value\(s\) \[5\]"),
        (TYPES, {"viscosity": None}, "give --viscosity"),
        (TYPES, {"dx": None}, "give --particle-radius"),
        (TYPES, {"bounds": None}, "metadata.json: bounds is missing"),
        (TYPES, {"dim": 3, "bounds": [[0, 1]] * 2}, "dim is 3 and bounds has shape"),
        (TYPES, {"g_ext_magnitude": 1.0}, "--gravity"),
        (TYPES, {"dt": "0.1"}, "metadata.json: dt is '0.1'"),
    ],
)
def test_what_cannot_be_used_is_refused(
    types: np.ndarray[Any, Any],
    changes: dict[str, Any],
    words: str,
    write_cavity: Write,
    tmp_path: Path,
) -> None:
    folder = write_cavity(types, **changes)
    with pytest.raises(UserError, match=words):
        convert(folder, "--root", tmp_path / "out")
    assert not [*(tmp_path / "out").glob("*")]


def test_code_is_never_run(
    write_cavity: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_cavity()
    (folder / "force.py").write_text("raise SystemExit('it ran')")
    with pytest.raises(UserError, match=r"force\.py, which is code and is not run; give .*--grav"):
        convert(folder, "--root", tmp_path / "out")
    convert(folder, "--root", tmp_path / "out", "--gravity", 0, -1, 0)
    assert (
        "force.py, which is code and is not run; it is taken as the constant"
        in capsys.readouterr().err
    )


def test_a_damaged_file_leaves_nothing(write_cavity: Write, tmp_path: Path) -> None:
    folder = write_cavity()
    with h5py.File(folder / "valid.h5", "a") as file:
        file["00001/position"][5, 1, 0] = np.nan
    with pytest.raises(UserError, match="00001: frame 5 has numbers that are not finite"):
        convert(folder, "--root", tmp_path / "out")
    assert not [*(tmp_path / "out").iterdir()]
    with pytest.raises(UserError, match=r"already holds train\.h5"):
        (tmp_path / "out" / "train.h5").touch()
        convert(folder, "--root", tmp_path / "out")


def same(one: h5py.Group, other: h5py.Group, *names: str) -> None:
    for name in names:
        assert np.array_equal(one[name][()], other[name][()]), name


def test_there_and_back_loses_nothing(sample: Path, tmp_path: Path) -> None:
    convert(sample, "--to", "lagrangebench", "--root", tmp_path / "theirs")
    convert(tmp_path / "theirs", "--root", tmp_path / "ours")
    for split in ("train", "val", "test"):
        with (
            h5py.File(sample / f"{split}.h5") as before,
            h5py.File(tmp_path / "ours" / f"{split}.h5") as after,
        ):
            assert Header.read(after) == Header.read(before)
            assert simulations(after) == simulations(before)
            for name in simulations(before):
                one, other = before[name], after[name]
                assert SceneAttributes.read(one) == SceneAttributes.read(other)
                same(one, other, "position", "velocity", "solid_position", "time", "solver_seconds")
                assert {key: other.attrs[key] for key in ("seed", "scene_parameters", "threads")}
                assert other.attrs["seed"] == one.attrs["seed"]


def test_moving_solids_and_planes_come_back(write_file: Write, tmp_path: Path) -> None:
    path = write_file("train.h5", (4, 5, 3), dimension=2, particle_radius=0.05)
    with h5py.File(path, "a") as file:
        group = file["00000"]
        group["position"][..., 2], group["velocity"][..., 2] = 0.25, 0
        rest = group["solid_position"][()]
        rest[:, 2] = 0.25
        del group["solid_position"]
        # The second solid turns about its own center: it moves and stays where it is.
        for dataset in create_frames(group, 3, ("solid_position", "solid_velocity")):
            dataset.resize(4, axis=0)
        group["solid_position"][...], group["solid_velocity"][...] = rest, 0
        group["solid_velocity"][2, 1] = 0.5, 0, 0
    convert(tmp_path, "--to", "lagrangebench", "--root", tmp_path / "theirs")
    with h5py.File(tmp_path / "theirs" / "train.h5") as file:
        assert file["00000/particle_type"][()].tolist() == [0] * 5 + [1, 2, 1]
        assert file["00000/position"].shape == (4, 8, 2)
    convert(tmp_path / "theirs", "--root", tmp_path / "ours")
    with h5py.File(path) as before, h5py.File(tmp_path / "ours" / "train.h5") as after:
        names = "position", "velocity", "solid_position", "solid_velocity"
        same(before["00000"], after["00000"], *names)
        assert SceneAttributes.read(before["00000"]) == SceneAttributes.read(after["00000"])


def test_back_and_there_loses_nothing(
    lennard_jones: Path, write_cavity: Write, tmp_path: Path
) -> None:
    for folder, more in ((lennard_jones, ("--viscosity", 0)), (write_cavity(), ())):
        ours, theirs = tmp_path / f"{folder.name}_ours", tmp_path / f"{folder.name}_theirs"
        convert(folder, "--root", ours, *more)
        convert(ours, "--to", "lagrangebench", "--root", theirs)
        before = json.loads((folder / "metadata.json").read_text())
        after = json.loads((theirs / "metadata.json").read_text())
        assert {key: after[key] for key in before} == before
        for path in folder.glob("*.h5"):
            with h5py.File(path) as one, h5py.File(theirs / path.name) as other:
                assert [*one] == [*other]
                for name in one:
                    same(one[name], other[name], "particle_type", "position")


def test_the_metadata_has_what_the_loader_reads(sample: Path, tmp_path: Path) -> None:
    convert(sample, "--to", "lagrangebench", "--root", tmp_path / "theirs")
    metadata = json.loads((tmp_path / "theirs" / "metadata.json").read_text())
    steps, changes = [], []
    for split in ("train", "val", "test"):
        with h5py.File(sample / f"{split}.h5") as file:
            for group in file.values():
                position = group["position"][()].astype(np.float64)
                step = np.diff(position, axis=0)
                steps.append([step.mean((0, 1)), np.square(step).mean((0, 1))])
                change = np.diff(step, axis=0)
                changes.append([change.mean((0, 1)), np.square(change).mean((0, 1))])
    for name, moments in (("vel", steps), ("acc", changes)):
        mean, square = np.mean(moments, axis=0)
        assert metadata[f"{name}_mean"] == pytest.approx(mean.tolist(), abs=1e-12)
        expected = np.sqrt(square - mean**2)
        assert metadata[f"{name}_std"] == pytest.approx(expected.tolist(), rel=1e-9)
    assert metadata["bounds"] == [[0.0, 1.5], [0.0, 1.0], [0.0, 1.5]]
    assert metadata["periodic_boundary_conditions"] == [False] * 3
    assert (metadata["dim"], metadata["dx"], metadata["dt"]) == (3, 0.12, 0.02)
    assert (metadata["sequence_length_train"], metadata["num_trajs_train"]) == (40, 3)
    assert (metadata["sequence_length_test"], metadata["num_trajs_test"]) == (40, 1)
    assert metadata["num_particles_max"] == 539 + 1510
    assert metadata["default_connectivity_radius"] == 0.174


def test_statistics_of_a_periodic_box(lennard_jones: Path, tmp_path: Path) -> None:
    convert(lennard_jones, "--root", tmp_path / "ours", "--viscosity", 0)
    moments = []
    for split in ("train", "val", "test"):
        with h5py.File(tmp_path / "ours" / f"{split}.h5", "a") as file:
            # Without the source's own metadata, which would be written again.
            file.attrs["solver_parameters"] = "{}"
            position = file["00000/position"][()].astype(np.float64)
        step = np.diff(np.unwrap(position, period=5, axis=0), axis=0)
        moments.append([step.mean((0, 1)), np.square(step).mean((0, 1))])
    convert(tmp_path / "ours", "--to", "lagrangebench", "--root", tmp_path / "theirs")
    found = json.loads((tmp_path / "theirs" / "metadata.json").read_text())
    mean, square = np.mean(moments, axis=0)
    assert found["vel_std"] == pytest.approx(np.sqrt(square - mean**2).tolist(), rel=1e-9)


@pytest.mark.parametrize(
    ("sizes", "changes", "words"),
    [
        ([(4, 5, 1), (3, 5, 1)], {}, "3 to 4 frames"),
        ([(4, 5, 1)] * 2, {"domain_upper": [(1, 1, 1), (2, 1, 1)]}, "domain_upper differs"),
    ],
)
def test_what_lagrangebench_cannot_hold_is_refused(
    sizes: list[tuple[int, int, int]],
    changes: dict[str, Any],
    words: str,
    write_file: Write,
    tmp_path: Path,
) -> None:
    write_file("train.h5", *sizes, **changes)
    with pytest.raises(UserError, match=words):
        convert(tmp_path, "--to", "lagrangebench", "--root", tmp_path / "out")
    assert not [*(tmp_path / "out").iterdir()]


def test_the_period_is_not_changed(write_cavity: Write, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="its box is periodic, and bounds are the period"):
        convert(write_cavity(), "--root", tmp_path / "out", "--domain", 0, 0, 0, 1, 1, 1)


def test_velocities_of_unknown_units_are_not_taken(write_cavity: Write, tmp_path: Path) -> None:
    folder = write_cavity()
    with h5py.File(folder / "valid.h5", "a") as file:
        for group in file.values():
            group["velocity"] = np.full(group["position"].shape, 9.0)
    convert(folder, "--root", tmp_path / "out")
    with h5py.File(tmp_path / "out" / "val.h5") as file:
        assert np.abs(file["00000/velocity"]).max() < 5


def test_options_without_effect_are_refused(lennard_jones: Path, tmp_path: Path) -> None:
    for more, words in (
        (("--walls", "a.ply"), "--walls has no effect on LagrangeBench data"),
        (("--to", "lagrangebench", "--dt", 1), "--dt has no effect on --to lagrangebench"),
        (("--to", "lagrangebench", "--format", "frames"), "--format is that of the source"),
    ):
        with pytest.raises(UserError, match=words):
            convert(lennard_jones, "--root", tmp_path / "out", *more)


def test_a_data_set_of_ones_own_is_recognized(sample: Path, tmp_path: Path) -> None:
    shutil.copytree(sample, tmp_path / "own")
    with pytest.raises(UserError, match="is it a data set of FluidsNet already"):
        convert(tmp_path / "own", "--root", tmp_path / "out")
