"""Tests of USD files, opened with pxr."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from fluidsnet.errors import UserError
from fluidsnet.export.frames import Frame, Frames
from fluidsnet.export.surface import SurfaceSettings, reconstruct
from fluidsnet.export.usd import UsdFile


def written(frames: Frames, path: Path, rate: float | None = None) -> Any:
    with UsdFile(path, frames, rate) as file:
        for frame in frames:
            file.append(frame)
    return Usd.Stage.Open(str(path))


def test_particles_are_those_that_were_written(frames: Frames, tmp_path: Path) -> None:
    stage = written(frames, tmp_path / "deep" / "a.usdc")
    assert os.listdir(tmp_path / "deep") == ["a.usdc"]
    points = UsdGeom.Points(stage.GetPrimAtPath("/fluid/particles"))
    codes = points.GetPointsAttr().GetTimeSamples()
    assert codes == points.GetVelocitiesAttr().GetTimeSamples() == [2, 3, 4, 5, 6, 7, 8]
    for code, frame in zip(codes, frames, strict=True):
        assert code / stage.GetTimeCodesPerSecond() == pytest.approx(frame.time)
        np.testing.assert_array_equal(points.GetPointsAttr().Get(code), frame.position)
        np.testing.assert_array_equal(points.GetVelocitiesAttr().Get(code), frame.velocity)
        np.testing.assert_array_equal(points.GetIdsAttr().Get(code), frame.ids)
        width = np.float32(2 * frames.radius())
        np.testing.assert_array_equal(points.GetWidthsAttr().Get(code), np.full(330, width))
        extent = np.array(points.GetExtentAttr().Get(code))
        np.testing.assert_allclose(extent[0], frame.position.min(axis=0) - width / 2, rtol=1e-6)
        np.testing.assert_allclose(extent[1], frame.position.max(axis=0) + width / 2, rtol=1e-6)


def test_a_stage_says_units_axis_and_times(simulation: Frames, tmp_path: Path) -> None:
    stage = written(simulation, tmp_path / "a.usd")
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 10
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (2, 8)
    assert stage.GetDefaultPrim().GetPath() == "/fluid"
    stage = written(replace(simulation, gravity=(0.0, 1.0, -9.0)), tmp_path / "z.usdc", rate=24)
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetTimeCodesPerSecond() == 24
    points = UsdGeom.Points(stage.GetPrimAtPath("/fluid/particles"))
    assert points.GetPointsAttr().GetTimeSamples() == pytest.approx(24 * simulation.times)


def test_the_surface_is_that_of_each_frame(simulation: Frames, tmp_path: Path) -> None:
    radius, settings = simulation.radius(), SurfaceSettings(cube_size=1.0)
    meshes = [reconstruct(frame, radius, settings) for frame in simulation]
    with UsdFile(tmp_path / "a.usdc", simulation) as file:
        for frame, mesh in zip(simulation, meshes, strict=True):
            file.append(frame, mesh)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    surface = UsdGeom.Mesh(stage.GetPrimAtPath("/fluid/surface"))
    assert surface.GetSubdivisionSchemeAttr().Get() == "none"
    assert len({len(mesh.vertices) for mesh in meshes}) > 1
    for code, mesh in zip(range(2, 9), meshes, strict=True):
        np.testing.assert_array_equal(surface.GetPointsAttr().Get(code), mesh.vertices)
        np.testing.assert_array_equal(surface.GetVelocitiesAttr().Get(code), mesh.velocity)
        np.testing.assert_array_equal(surface.GetNormalsAttr().Get(code), mesh.normals)
        assert set(surface.GetFaceVertexCountsAttr().Get(code)) == {3}
        corners = np.array(surface.GetFaceVertexIndicesAttr().Get(code)).reshape(-1, 3)
        np.testing.assert_array_equal(corners, mesh.triangles)
        assert UsdGeom.Mesh.ValidateTopology(
            surface.GetFaceVertexIndicesAttr().Get(code),
            surface.GetFaceVertexCountsAttr().Get(code),
            len(mesh.vertices),
        )[0]


def test_places_far_from_zero_keep_their_digits(tmp_path: Path) -> None:
    position = np.array([4e6, -2e6, 10.0]) + np.random.default_rng(0).random((9, 3))
    frame = Frame.of(0.0, position, np.zeros((9, 3)))
    frames = Frames("far", np.zeros(1), range(1), lambda _: frame, particle_radius=0.01)
    stage = written(frames, tmp_path / "a.usdc")
    points = UsdGeom.Points(stage.GetPrimAtPath("/fluid/particles"))
    matrix = np.array(points.ComputeLocalToWorldTransform(0))
    found = np.array(points.GetPointsAttr().Get(0), float) @ matrix[:3, :3] + matrix[3, :3]
    np.testing.assert_allclose(found, position, rtol=0, atol=1e-7)


def test_an_exception_leaves_the_older_file(simulation: Frames, tmp_path: Path) -> None:
    path = tmp_path / "a.usdc"
    written(simulation, path)
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt), UsdFile(path, simulation) as file:
        file.append(next(iter(simulation)))
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == [path.name]
    assert path.read_bytes() == before


def test_a_file_of_another_program_is_refused(simulation: Frames, tmp_path: Path) -> None:
    path = tmp_path / "a.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.Sphere.Define(stage, "/mine")
    stage.Save()
    (tmp_path / "b.usd").write_text("not USD")
    for path in tmp_path.iterdir():
        before = path.read_bytes()
        with pytest.raises(UserError, match="not written by this command"):
            UsdFile(path, simulation)
        assert path.read_bytes() == before


def test_a_state_that_blew_up_is_kept_as_it_is(tmp_path: Path) -> None:
    position = np.full((3, 3), np.nan, np.float32)
    frame = Frame.of(0.5, position, position)
    frames = Frames("nan", np.array([0.5]), range(1), lambda _: frame, particle_radius=0.01)
    stage = written(frames, tmp_path / "a.usdc")
    points = UsdGeom.Points(stage.GetPrimAtPath("/fluid/particles"))
    assert np.isnan(points.GetPointsAttr().Get(12)).all()  # 24 time codes a second
    assert not points.GetExtentAttr().HasValue()


def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    script = f"""
import numpy as np
from pathlib import Path
from fluidsnet.export.frames import Frame, Frames
from fluidsnet.export.usd import UsdFile
def anonymous():
    for line in open("/proc/self/status"):
        if line.startswith("RssAnon"):
            return int(line.split()[1]) / 1e3
random, times = np.random.default_rng(0), np.arange(80.0)
frames = Frames("many", times, range(80), lambda _: None, particle_radius=0.1)
with UsdFile(Path({str(tmp_path / "a.usdc")!r}), frames) as file:
    for time in times:
        position = random.random((50_000, 3), np.float32)
        file.append(Frame.of(time, position, position + 1))
        if time == 15:
            start = anonymous()
    print(anonymous() - start)
"""
    result = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    assert float(result.stdout) < 20  # MB; the samples of 64 frames are 77 MB
    assert (tmp_path / "a.usdc").stat().st_size > 80e6


@pytest.mark.parametrize(
    ("name", "rate", "message"),
    [
        ("a.usda", None, r"must end in \.usdc"),
        ("a.usdc", 0.0, "--fps is 0"),
        ("b.usd", 1, "folder"),
    ],
)
def test_what_cannot_be_written(
    simulation: Frames, tmp_path: Path, name: str, rate: float | None, message: str
) -> None:
    (tmp_path / "b.usd").mkdir()
    with pytest.raises(UserError, match=message):
        UsdFile(tmp_path / name, simulation, rate)
