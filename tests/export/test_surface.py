"""Tests of surface meshes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from fluidsnet.errors import UserError
from fluidsnet.export.frames import Frame, Frames
from fluidsnet.export.sequence import SequenceFolder
from fluidsnet.export.surface import Mesh, SurfaceSettings, reconstruct, write_mesh
from fluidsnet.export.surface_files import surfaces, write_surfaces

RADIUS = 0.05


def block() -> Frame:
    """16 × 12 × 14 particles at rest that move to the right."""
    axes = [np.arange(count) * 2 * RADIUS for count in (16, 12, 14)]
    position = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return Frame.of(0.0, position.astype(np.float32), np.full((len(position), 3), (2, 0, 0)))


def volume(mesh: Mesh) -> float:
    """Volume inside a closed mesh; positive if its triangles are seen counterclockwise."""
    a, b, c = (mesh.vertices[mesh.triangles[:, corner]].astype(float) for corner in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def open_edges(mesh: Mesh) -> int:
    """Number of directed edges without their opposite."""
    ends = np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    edges = set(map(tuple, ends.tolist()))
    return sum((end, start) not in edges for start, end in edges)


def test_the_surface_of_a_block_encloses_its_volume() -> None:
    frame = block()
    mesh = reconstruct(frame, RADIUS, SurfaceSettings())
    assert volume(mesh) == pytest.approx(len(frame.position) * (2 * RADIUS) ** 3, rel=0.05)
    assert open_edges(mesh) == 0
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [1.55, 1.15, 1.35], atol=RADIUS / 2)
    np.testing.assert_allclose(mesh.velocity, np.full_like(mesh.vertices, (2, 0, 0)), atol=1e-4)
    outward = mesh.vertices - mesh.vertices.mean(axis=0)
    assert (outward * mesh.normals).sum(axis=1).min() > 0
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, rtol=1e-5)


def test_settings_reach_the_reconstruction() -> None:
    frame = block()
    fine = reconstruct(frame, RADIUS, SurfaceSettings())
    coarse = reconstruct(frame, RADIUS, SurfaceSettings(cube_size=1.0))
    assert len(coarse.vertices) < len(fine.vertices) / 3
    inner = reconstruct(frame, RADIUS, SurfaceSettings(threshold=0.9))
    assert volume(inner) < volume(fine)
    rough = reconstruct(frame, RADIUS, SurfaceSettings(smoothing_iterations=0, normal_iterations=0))
    assert abs(volume(rough) - volume(fine)) > 1e-3


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".vtk"])
def test_meshes_are_read_as_written(simulation: Frames, tmp_path: Path, suffix: str) -> None:
    frame = list(simulation)[-1]
    mesh = reconstruct(frame, simulation.radius(), SurfaceSettings(cube_size=1.0))
    write_mesh(tmp_path / f"a{suffix}", mesh)
    found = meshio.read(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(found.points.astype(np.float32), mesh.vertices)
    np.testing.assert_array_equal(found.cells_dict["triangle"], mesh.triangles)
    if suffix == ".ply":
        for name, values in (("n", mesh.normals), ("v", mesh.velocity)):
            columns = [found.point_data[name + axis] for axis in "xyz"]
            np.testing.assert_array_equal(np.stack(columns, axis=1), values)
    if suffix == ".vtk":
        np.testing.assert_array_equal(found.point_data["normals"], mesh.normals)
        np.testing.assert_array_equal(found.point_data["velocity"], mesh.velocity)


@pytest.mark.parametrize("workers", [1, 2])
def test_frames_keep_their_order(simulation: Frames, workers: int) -> None:
    settings = SurfaceSettings(cube_size=1.0)
    pairs = list(surfaces(simulation, settings, workers))
    assert [frame.time for frame, _ in pairs] == list(simulation.times)
    for frame, mesh in pairs:
        alone = reconstruct(frame, simulation.radius(), settings)
        # Threads may order the vertices differently.
        assert len(mesh.vertices) == len(alone.vertices)
        assert volume(mesh) == pytest.approx(volume(alone), rel=1e-4)


def test_files_are_those_of_their_frames(simulation: Frames, tmp_path: Path) -> None:
    settings = SurfaceSettings(cube_size=1.0)
    with SequenceFolder(tmp_path / "mesh", ".ply") as folder:
        assert len(list(write_surfaces(simulation, folder, settings, workers=2))) == 7
    for index, frame in enumerate(simulation):
        found = meshio.read(tmp_path / "mesh" / f"mesh.{index:04d}.ply")
        alone = reconstruct(frame, simulation.radius(), settings)
        np.testing.assert_array_equal(found.points, alone.vertices)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_state_that_blew_up_has_no_surface(simulation: Frames, workers: int) -> None:
    def read(index: int) -> Frame:
        frame = simulation.read(index)
        if index >= 20:
            frame.position[5] = np.nan
        return frame

    frames = replace(simulation, read=read)
    with pytest.raises(UserError, match=r"At 0\.4 s, 1 of 330 .* end before with --last"):
        list(surfaces(frames, SurfaceSettings(), workers))


def test_two_dimensions_have_no_surface(simulation: Frames) -> None:
    with pytest.raises(UserError, match="two dimensions"):
        surfaces(replace(simulation, dimension=2), SurfaceSettings(), 1)


@pytest.mark.parametrize(
    ("name", "value"), [("cube_size", 0.0), ("threshold", -1.0), ("smoothing_iterations", -1)]
)
def test_settings_out_of_range(name: str, value: float) -> None:
    with pytest.raises(UserError, match=f"--mesh.{name} is {value}"):
        SurfaceSettings(**{name: value})  # type: ignore[arg-type]
