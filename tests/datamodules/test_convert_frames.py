"""Tests of `fluidsnet convert` on folders of VTK, PLY and BGEO frames."""

from __future__ import annotations

import gzip
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkPolyData, vtkUnstructuredGrid
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
from vtkmodules.vtkIOPLY import vtkPLYWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

from datamodules.convert.bgeo_file import read_bgeo
from datamodules.convert.command import convert_command
from datamodules.convert.ply_file import read_ply
from datamodules.convert.vtk_file import read_vtk
from datamodules.generate.particle_file import write_bgeo
from datamodules.inspection import summarize
from datamodules.schema import Header, SceneAttributes
from fluidsnet.errors import UserError

Array = np.ndarray[Any, Any]

#: A falling block; the solver sorts its particles, so that rows change and ids tell them apart.
SCENE = {
    "Configuration": {
        "particleRadius": 0.05,
        "simulationMethod": 4,
        "timeStepSize": 0.005,
        "cflMethod": 0,
        "enableZSort": True,
        "boundaryHandlingMethod": 0,
        "enablePartioExport": True,
        "enableVTKExport": True,
        "dataExportFPS": 50,
        "particleAttributes": "velocity;density",
    },
    "FluidBlocks": [{"start": [0, 0.5, 0], "end": [0.5, 1, 0.5], "initialVelocity": [1, 0, 0]}],
}
EXPORT = """
import sys
from pathlib import Path
from datamodules.generate.solver import load_solver
folder = Path(sys.argv[1])
base = load_solver().Exec.SimulatorBase()
base.init(sceneFile=str(folder / "scene.json"), outputDir=str(folder), stopAt=0.1, useGui=False,
          initialPause=False, useCache=False)
base.initSimulation()
base.runSimulation()
base.cleanup()
"""
VALUES = ("--dt", 0.02, "--particle-radius", 0.05, "--gravity", 0, -9.81, 0, "--viscosity", 0.01)
BOX = ("--domain", -1, -1, -1, 2, 2, 2)
ALL = (*VALUES, *BOX, "--split", "test=*")


def convert(*arguments: object) -> None:
    convert_command([str(argument) for argument in arguments])


@pytest.fixture(scope="session")
def exported(real_solver: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames of the real solver: the folders vtk and partio."""
    folder = tmp_path_factory.mktemp("exported") / "block"
    folder.mkdir()
    (folder / "scene.json").write_text(json.dumps(SCENE))
    subprocess.run(
        [sys.executable, "-c", EXPORT, str(folder)],
        check=True,
        capture_output=True,
        env={**os.environ, "OMP_WAIT_POLICY": "passive"},
    )
    return folder


@pytest.mark.parametrize("pattern", ["*.vtk", "*.bgeo"])
def test_frames_of_the_solver(pattern: str, exported: Path, tmp_path: Path) -> None:
    convert(exported, "--root", tmp_path, "--frames", pattern, *ALL)
    with h5py.File(tmp_path / "test.h5") as file:
        group = file["00000"]
        assert group.attrs["source"] == "block"
        position, velocity = group["position"][()], group["velocity"][()]
        assert len(position) >= 5
        # At the first frame all move as the block; until then none has met another.
        assert velocity[0, :, 0] == pytest.approx(1, abs=0.2)
        # A row is a particle: where it changed to another, it would move by a spacing.
        missed = np.diff(position, axis=0) - 0.02 * (velocity[1:] + velocity[:-1]) / 2
        assert np.abs(missed).max() < 0.02
        assert SceneAttributes.read(group) == SceneAttributes(
            (-1, -1, -1), (2, 2, 2), (0, -9.81, 0), 1000, 0.01
        )
        header = Header.read(file)
        assert (header.dt, header.particle_radius, header.support_radius) == (0.02, 0.05, 0.2)
    assert "nothing suspicious" in summarize(tmp_path / "test.h5").text


def test_both_exports_hold_the_same(exported: Path) -> None:
    (vtk,) = (exported / "vtk").glob("*_3.vtk")
    (bgeo,) = (exported / "partio").glob("*_3.bgeo")
    assert bgeo.read_bytes()[:2] == b"\x1f\x8b"  # Partio compresses
    one, other = read_vtk(vtk), read_bgeo(bgeo)
    assert np.array_equal(one.position, other.position)
    for name in ("id", "velocity", "density"):
        assert np.array_equal(one.fields[name], other.fields[name]), name
    # Sorting changed the rows, so that the test above means something.
    assert not np.array_equal(one.fields["id"], np.arange(len(one.position)))


def test_several_exports_ask_for_a_choice(exported: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"several folders; choose with --frames"):
        convert(exported, "--root", tmp_path, *ALL)


def points_of(count: int = 6, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(size=(count, 3)).astype(np.float32)


def dataset(kind: type, position: Array, **fields: Array) -> Any:
    data, points = kind(), vtkPoints()
    points.SetData(numpy_to_vtk(position, deep=True))
    data.SetPoints(points)
    for name, values in fields.items():
        array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
        array.SetName(name)
        data.GetPointData().AddArray(array)
    return data


def write_vtk(path: Path, position: Array, text: bool = False, **fields: Array) -> None:
    """Write a file with VTK's own writer for its suffix; .vtk is DualSPHysics's polygonal data."""
    writers: dict[str, tuple[Any, Any]] = {
        ".vtk": (vtkPolyDataWriter, vtkPolyData),
        ".vtp": (vtkXMLPolyDataWriter, vtkPolyData),
        ".vtu": (vtkXMLUnstructuredGridWriter, vtkUnstructuredGrid),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    writer, kind = writers[path.suffix]
    out = writer()
    out.SetFileName(str(path))
    out.SetInputData(dataset(kind, position, **fields))
    if path.suffix == ".vtk":
        out.SetFileTypeToASCII() if text else out.SetFileTypeToBinary()
    assert out.Write() == 1


def write_ply(path: Path, position: Array, velocity: Array | None = None, order: str = "<") -> None:
    names = ["x", "y", "z", *([] if velocity is None else ["vx", "vy", "vz"])]
    rows = np.concatenate([position, *([] if velocity is None else [velocity])], axis=1)
    kind = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    lines = ["ply", f"format {kind} 1.0", "comment made by a test", f"element vertex {len(rows)}"]
    lines += [f"property float {name}" for name in names]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header", ""]
    path.parent.mkdir(parents=True, exist_ok=True)
    body = rows.astype(f"{order}f4").tobytes() + bytes([3, *[0] * 12])
    if not order:
        body = "\n".join([*(" ".join(map(str, row)) for row in rows), "3 0 1 2", ""]).encode()
    path.write_bytes("\n".join(lines).encode() + body)


@pytest.mark.parametrize("suffix", [".vtk", ".vtp", ".vtu"])
def test_vtk_files_by_their_own_writers(suffix: str, tmp_path: Path) -> None:
    position, velocity = points_of(), points_of(seed=1)
    path = tmp_path / f"PartFluid_0000{suffix}"
    write_vtk(path, position, Idp=np.arange(6, dtype=np.uint32)[::-1], Vel=velocity)
    points = read_vtk(path).sorted()
    assert np.array_equal(points.position, position[::-1])
    assert np.array_equal(points.velocity(), velocity[::-1])


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_ply_files_with_velocities(order: str, tmp_path: Path) -> None:
    position, velocity = points_of(), points_of(seed=1)
    write_ply(tmp_path / "a.ply", position, velocity, order)
    points = read_ply(tmp_path / "a.ply")
    assert np.allclose(points.position, position) and np.allclose(points.velocity(), velocity)


def test_ply_files_of_vtk(tmp_path: Path) -> None:
    position = points_of()
    for binary in (True, False):
        out = vtkPLYWriter()
        out.SetFileName(str(tmp_path / "a.ply"))
        out.SetInputData(dataset(vtkPolyData, position))
        out.SetFileTypeToBinary() if binary else out.SetFileTypeToASCII()
        assert out.Write() == 1
        points = read_ply(tmp_path / "a.ply")
        assert np.allclose(points.position, position, atol=1e-5)
        assert points.velocity() is None and points.numbers() is None


def test_bgeo_files_without_attributes(tmp_path: Path) -> None:
    position = points_of()
    write_bgeo(tmp_path / "a.bgeo", position.astype(np.float64))
    points = read_bgeo(tmp_path / "a.bgeo")
    assert np.array_equal(points.position, position) and not points.fields


@pytest.mark.parametrize("suffix", [".vtk", ".ply", ".bgeo", ".vtp", "_text.vtk"])
@pytest.mark.parametrize("share", [0, 0.02, 0.1, 0.3, 0.6, 0.8])
def test_truncated_files_are_refused(
    suffix: str, share: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".bgeo":
        write_bgeo(path, points_of(200).astype(np.float64))
    elif suffix == ".ply":
        write_ply(path, points_of(200))
    else:
        text = suffix == "_text.vtk"
        write_vtk(path, points_of(200), text, velocity=points_of(200))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    read: dict[str, Callable[[Path], object]] = {".ply": read_ply, ".bgeo": read_bgeo}
    with pytest.raises(UserError, match=f"a{suffix}"):
        read.get(path.suffix, read_vtk)(path)
    assert capfd.readouterr().err == ""  # VTK's own text is kept back


def test_houdinis_newer_format_is_refused(tmp_path: Path) -> None:
    with gzip.open(tmp_path / "a.bgeo", "wb") as file:
        file.write(b"\x7fNSJb" + bytes(40))
    with pytest.raises(UserError, match="BGEO of version 5, Houdini's classic format"):
        read_bgeo(tmp_path / "a.bgeo")


def write_motion(folder: Path, frames: int = 4, speed: float = 2.0) -> Array:
    """Write frames of particles that move along x, without velocities; return the first."""
    position = points_of()
    for frame in range(frames):
        moved = position + np.float32(0.02 * speed * frame) * np.float32([1, 0, 0])
        write_ply(folder / f"fluid_{frame:04d}.ply", moved)
    return position


def test_velocities_are_differences_where_there_are_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_motion(tmp_path / "in")
    convert(tmp_path / "in", "--root", tmp_path / "out", *ALL)
    with h5py.File(tmp_path / "out" / "test.h5") as file:
        assert file["00000/velocity"].shape == (4, 6, 3)
        expected = np.tile([2.0, 0, 0], (4, 6, 1))
        assert np.allclose(file["00000/velocity"], expected, atol=1e-4)
    printed = capsys.readouterr().err
    assert "in has no velocities" in printed and "row i is taken for the same one" in printed


def test_a_folder_a_simulation_and_walls(tmp_path: Path) -> None:
    for name in ("a", "b", "c/run", "d"):
        write_motion(tmp_path / "in" / name)
    walls = np.array(np.meshgrid([0, 3], [0, 2], [0, 1])).reshape(3, -1).T.astype(np.float64)
    write_bgeo(tmp_path / "walls.bgeo", walls)
    convert(
        *(tmp_path / "in", "--root", tmp_path / "out", *VALUES),
        *("--walls", tmp_path / "walls.bgeo", "--split", "train=a,d", "val=b", "test=c/*"),
    )
    with h5py.File(tmp_path / "out" / "train.h5") as file:
        assert [group.attrs["source"] for group in file.values()] == ["a", "d"]
        assert np.array_equal(file["00001/solid_position"][()], walls)
        assert SceneAttributes.read(file["00001"]).domain_upper == (3, 2, 1)
    with h5py.File(tmp_path / "out" / "test.h5") as file:
        assert file["00000"].attrs["source"] == "c/run"


def test_fluids_of_several_sequences_are_joined(tmp_path: Path) -> None:
    for frame in range(3):
        for name, count in (("water", 4), ("oil", 2), ("floor", 9)):
            path = tmp_path / "in" / f"{name}_{frame}.vtk"
            identity = np.arange(count, dtype=np.int32)
            write_vtk(path, points_of(count), id=identity, velocity=points_of(count))
    with pytest.raises(UserError, match=r"one or more of 'floor_\*\.vtk', 'oil_\*\.vtk'"):
        convert(tmp_path / "in", "--root", tmp_path / "out", *ALL)
    convert(tmp_path / "in", "--root", tmp_path / "out", *ALL, "--frames", "water*", "oil*")
    with h5py.File(tmp_path / "out" / "test.h5") as file:
        expected = np.concatenate([points_of(4), points_of(2)])
        assert np.array_equal(file["00000/position"][2], expected)


def other_particles(folder: Path) -> None:
    identity = np.array([0, 1, 2, 3, 4, 7], np.int32)
    write_vtk(folder / "f_1.vtk", points_of(), id=identity, velocity=points_of())


def twice(folder: Path) -> None:
    identity = np.array([0, 1, 2, 3, 4, 4], np.int32)
    write_vtk(folder / "f_0.vtk", points_of(), id=identity, velocity=points_of())


def unnumbered(folder: Path) -> None:
    write_vtk(folder / "f_1.vtk", points_of(), velocity=points_of())


def motionless(folder: Path) -> None:
    identity = np.arange(6, dtype=np.int32)
    write_vtk(folder / "f_2.vtk", points_of(), id=identity)


def gap(folder: Path) -> None:
    shutil.move(folder / "f_2.vtk", folder / "f_3.vtk")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (other_particles, r"f_1\.vtk: it has other particles.* \(1 are missing, 1 are new\)"),
        (twice, r"f_0\.vtk: two particles have the same number"),
        (unnumbered, r"f_1\.vtk: some frames have numbers"),
        (motionless, "some of its frames have no velocity"),
        (gap, r"after f_1\.vtk comes f_3\.vtk"),
    ],
)
def test_faults_are_named(spoil: Callable[[Path], None], words: str, tmp_path: Path) -> None:
    for frame in range(3):
        identity = np.arange(6, dtype=np.int32)
        path = tmp_path / "in" / f"f_{frame}.vtk"
        write_vtk(path, points_of(), id=identity, velocity=points_of())
    spoil(tmp_path / "in")
    with pytest.raises(UserError, match=words):
        convert(tmp_path / "in", "--root", tmp_path / "out", *ALL)
    assert not [*(tmp_path / "out").glob("*")]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (BOX, "give --dt, --particle-radius, --gravity, --viscosity"),
        (VALUES, "give --domain X0 Y0 Z0 X1 Y1 Z1"),
        ((*VALUES, *BOX), r"say which simulation is in which file, as in `--split train=a,b"),
        ((*ALL, "--frames", "*.vtk"), r"no frames, .* match \*\.vtk"),
        ((*ALL, "--walls", "box.obj"), "sample a mesh first"),
        ((*ALL, "--dt", 0), "--dt is 0; it must be finite and above zero"),
        ((*ALL, "--domain", 0, 0, 0, 1, 1, 0), "--domain is .* the lower corner"),
    ],
)
def test_what_is_not_known_is_asked_for(
    options: tuple[object, ...], words: str, tmp_path: Path
) -> None:
    write_motion(tmp_path / "in")
    with pytest.raises(UserError, match=words):
        convert(tmp_path / "in", "--root", tmp_path / "out", *options)


def test_an_unknown_format_is_named(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").touch()
    with pytest.raises(UserError, match=r"its format is not known; expected metadata\.json"):
        convert(tmp_path, "--root", tmp_path / "out")
    with pytest.raises(UserError, match="there is no such folder"):
        convert(tmp_path / "gone", "--root", tmp_path / "out")
