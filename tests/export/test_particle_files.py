"""Tests of PLY and BGEO files, read back with the readers of other projects."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pysplashsurf.bgeo  # registers BGEO with meshio
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOPLY import vtkPLYReader

from fluidsnet.export.bgeo import write_bgeo
from fluidsnet.export.frames import Frame, Frames
from fluidsnet.export.ply import write_ply

# Partio, in a process of its own: the solver's libGL and VTK's do not go together.
_PARTIO = """
import sys
import numpy as np
from datamodules.generate.solver import load_solver
utilities = load_solver().Utilities
position, velocity = utilities.VecVector3r(), utilities.VecVector3r()
rotation, start = np.eye(3, dtype=np.float32), np.zeros(3, np.float32)
read = utilities.PartioReaderWriter.readParticle
assert read(sys.argv[1], start, rotation, 1.0, position, velocity)
np.savez(sys.argv[2], position=np.array(position), velocity=np.array(velocity))
"""


def test_meshio_reads_ply(frames: Frames, tmp_path: Path) -> None:
    for frame in frames:
        write_ply(tmp_path / "a.ply", frame)
        found = meshio.read(tmp_path / "a.ply")
        assert found.points.dtype == np.float32
        np.testing.assert_array_equal(found.points, frame.position)
        velocity = np.stack([found.point_data[name] for name in ("vx", "vy", "vz")], axis=1)
        assert velocity.dtype == np.float32
        np.testing.assert_array_equal(velocity, frame.velocity)
        np.testing.assert_array_equal(found.point_data["id"], frame.ids)


def test_vtk_reads_ply(simulation: Frames, tmp_path: Path) -> None:
    frame = next(iter(simulation))
    write_ply(tmp_path / "a.ply", frame)
    assert b"format binary" in (tmp_path / "a.ply").read_bytes()[:40]
    reader = vtkPLYReader()
    reader.SetFileName(str(tmp_path / "a.ply"))
    reader.Update()
    points = vtk_to_numpy(reader.GetOutput().GetPoints().GetData())  # type: ignore[no-untyped-call]
    np.testing.assert_array_equal(points, frame.position)


def test_ply_keeps_places_far_from_zero(tmp_path: Path) -> None:
    position = 4e6 + np.random.default_rng(0).random((9, 3))
    write_ply(tmp_path / "a.ply", Frame.of(0.0, position, np.zeros((9, 3))))
    np.testing.assert_array_equal(meshio.read(tmp_path / "a.ply").points, position)


def test_splashsurf_reads_bgeo(frames: Frames, tmp_path: Path) -> None:
    assert pysplashsurf.bgeo
    for frame in frames:
        write_bgeo(tmp_path / "a.bgeo", frame)
        found = meshio.read(tmp_path / "a.bgeo")
        np.testing.assert_array_equal(found.points, frame.position)
        np.testing.assert_array_equal(found.point_data["velocity"], frame.velocity)
        np.testing.assert_array_equal(found.point_data["id"], frame.ids)


@pytest.mark.usefixtures("real_solver")
def test_partio_reads_bgeo(simulation: Frames, tmp_path: Path) -> None:
    frame = list(simulation)[-1]
    write_bgeo(tmp_path / "a.bgeo", frame)
    arguments = [str(tmp_path / "a.bgeo"), str(tmp_path / "a.npz")]
    subprocess.run([sys.executable, "-c", _PARTIO, *arguments], check=True)
    found = np.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(found["position"], frame.position)
    np.testing.assert_array_equal(found["velocity"], frame.velocity)
