"""Starts sampled on lattices, beside those of the real solver."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from datamodules.generate.bodies import Block, Drop, MovingBody
from datamodules.generate.box_drops import BoxDrops
from datamodules.generate.driven import StirredTank, WaveMaker
from datamodules.generate.job import DrawnJob
from datamodules.generate.lattice import block_lattice, box_lattice, surface_lattice
from datamodules.generate.mesh import write_box
from datamodules.generate.process import run_job
from datamodules.generate.recipe import Recipe
from datamodules.generate.scene_file import SceneFile
from datamodules.generate.scene_file_job import SceneFileJob
from datamodules.generate.scene_file_plan import SceneFilePlan
from datamodules.generate.scenes import DropPool, SceneKind
from datamodules.generate.solid_course import SolidCourse
from datamodules.generate.start import lattice_start, solver_start
from datamodules.reader import FrameReader
from datamodules.schema import validate
from fluidsnet.errors import UserError
from fluidsnet.particles import Particles

needs_solver = pytest.mark.usefixtures("real_solver")


def job(kind: SceneKind, output: Path, radius: float = 0.05, frames: int = 2) -> DrawnJob:
    """Return the job of the first test scene of a kind."""
    recipe = Recipe(
        kind, radius, train=0, val=0, test=1, frames=frames, frame_interval=0.02, solver="DFSPH"
    )
    return recipe.job("test", 0, recipe.starts()["test", 0], output, threads=1)


def read(path: Path) -> Particles:
    validate(path)
    reader = FrameReader(path)
    state = reader.state("00000", 0, 1)
    reader.close()
    return state


def ordered(points: torch.Tensor) -> NDArray[np.float64]:
    """Return points (N, 3) in an order of their places."""
    rows = np.round(points.double().numpy(), 4)
    return np.asarray(rows[np.lexsort(rows.T)])


def test_a_block_and_a_box_are_lattices() -> None:
    block = block_lattice(Block((0.1, 0.0, 0.0), (0.4, 0.2, 0.1)), 0.05)
    assert len(block) == 3 * 2 * 1
    np.testing.assert_allclose(block.min(axis=0), [0.15, 0.05, 0.05])
    np.testing.assert_allclose(block.max(axis=0), [0.35, 0.15, 0.05])
    box = box_lattice(np.zeros(3), np.array([0.3, 0.2, 0.4]), 0.05)
    # All points of the grid but those inside, each once.
    assert len(box) == 4 * 3 * 5 - 2 * 1 * 3 == len(np.unique(box.round(6), axis=0))
    outline = box_lattice(np.array([0, 0, -1.0]), np.array([0.3, 0.2, 1.0]), 0.05, flat=True)
    assert len(outline) == 10 and (outline[:, 2] == 0).all()


def test_a_surface_is_sampled_at_most_a_spacing_apart() -> None:
    corners = np.array([(x, y, z) for x in (0.0, 0.3) for y in (0.0, 0.2) for z in (0.0, 0.4)])
    from datamodules.generate.moving_solids import BOX

    points = surface_lattice(corners, np.array(BOX) - 1, 0.05)
    expected = box_lattice(np.zeros(3), np.array([0.3, 0.2, 0.4]), 0.05)
    assert {*map(tuple, points.round(6))} == {*map(tuple, expected.round(6))}
    triangle = np.array([(0.0, 0, 0), (1.0, 0.1, 0), (0.3, 0.8, 0.2)])
    samples = surface_lattice(triangle, np.array([[0, 1, 2]]), 0.05)
    shares = np.random.default_rng(0).dirichlet([1, 1, 1], 2000)
    apart = np.linalg.norm((shares @ triangle)[:, None] - samples, axis=2).min(axis=1)
    assert apart.max() < 0.1 and len(samples) < 120


@needs_solver
@pytest.mark.parametrize(
    "kind",
    [
        DropPool((1.2, 1.2, 1.2)),
        BoxDrops(width=(1.5, 1.5), height=(1.5, 1.5), depth=(1.5, 1.5), volume=(0.2, 0.2)),
        StirredTank(),
    ],
    ids=lambda kind: type(kind).__name__,
)
def test_a_drawn_scene_is_that_of_the_solver(tmp_path: Path, kind: SceneKind) -> None:
    drawn = job(kind, tmp_path / "solver.h5")
    solver_start(drawn)
    lattice_start(replace(drawn, output=str(tmp_path / "lattice.h5")))
    solved, made = read(tmp_path / "solver.h5"), read(tmp_path / "lattice.h5")
    with h5py.File(tmp_path / "solver.h5") as file:
        assert len(file["00000/position"]) == 1
    if any(isinstance(body, Drop) for body in drawn.bodies):
        # Of a ball each samples what it may.
        assert len(made) == pytest.approx(len(solved), rel=0.05)
    else:
        np.testing.assert_allclose(ordered(made.position), ordered(solved.position), atol=2e-4)
    if any(isinstance(body, MovingBody) for body in drawn.bodies):
        assert made.velocity.norm(dim=1).max() > 0
    np.testing.assert_allclose(made.velocity.mean(dim=0), solved.velocity.mean(dim=0), atol=1e-5)
    for one, two in ((made, solved), (solved, made)):
        # Each wall is where the other has one, within a spacing.
        apart = torch.cdist(one.solid_position, two.solid_position).amin(dim=1)
        assert apart.max() < 2 * 0.05 * 1.01
    assert torch.equal(made.scene.domain_upper, solved.scene.domain_upper)
    assert torch.equal(made.scene.values, solved.scene.values)


@needs_solver
@pytest.mark.parametrize("kind", [StirredTank(), WaveMaker()], ids=["turns", "swings"])
def test_solids_move_as_in_the_solver(tmp_path: Path, kind: SceneKind) -> None:
    drawn = job(kind, tmp_path / "truth.h5", frames=6)
    assert run_job("truth", drawn, tmp_path) is None
    reader = FrameReader(tmp_path / "truth.h5")
    start = reader.state("00000", 0, 1)
    course = SolidCourse(drawn.solids, start.solid_position, 0.02)
    at_start, _ = course[0]
    np.testing.assert_allclose(at_start, start.solid_position, atol=1e-6)
    for frame in (1, 5):
        place, speed = course[frame]
        true_place, _ = reader.solids("00000", frame)
        way = float((true_place - start.solid_position).norm(dim=1).max())
        assert way > 0.0004 * frame**2
        # The solver's steps are 2.5 ms long.
        assert (place - true_place).norm(dim=1).max() < 0.15 * way
        before, after = course[frame - 1][0], course[frame + 1][0]
        np.testing.assert_allclose(speed, (after - before) / 0.04, atol=0.02)


@pytest.fixture
def scene(tmp_path: Path) -> dict[str, Any]:
    """Return a scene of a block and a mesh of fluid in a box, whose meshes are in the folder."""
    write_box(tmp_path / "box.obj", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    turned = {"rotationAxis": [0, 1, 0], "rotationAngle": 0.5, "scale": [0.31, 0.31, 0.31]}
    return {
        "Configuration": {"particleRadius": 0.05, "gravitation": [0, -5, 0]},
        "Materials": [{"id": "Fluid", "viscosityMethod": 1}],
        "RigidBodies": [
            {"geometryFile": "box.obj", "translation": [-0.5, 0, 2], "isWall": True},
            {"geometryFile": "box.obj", "translation": [0.1, 0, 2.5], **turned},
        ],
        "FluidBlocks": [
            {"denseMode": 0, "start": [-0.45, 0.1, 2.05], "end": [0.05, 0.6, 2.55],
             "initialVelocity": [0.0, 0.5, 0.0]}
        ],
    }  # fmt: skip


def scene_job(folder: Path, scene: dict[str, Any], name: str) -> SceneFileJob:
    path = folder / "scene.json"
    path.write_text(json.dumps(scene))
    ((_, found),) = SceneFilePlan(str(path)).jobs(folder, threads=1).items()
    assert isinstance(found, SceneFileJob)
    return replace(found, output=str(folder / name))


@needs_solver
def test_a_scene_file_is_that_of_the_solver(tmp_path: Path, scene: dict[str, Any]) -> None:
    solver_start(scene_job(tmp_path, scene, "solver.h5"))
    lattice_start(scene_job(tmp_path, scene, "lattice.h5"))
    solved, made = read(tmp_path / "solver.h5"), read(tmp_path / "lattice.h5")
    np.testing.assert_allclose(ordered(made.position), ordered(solved.position), atol=2e-4)
    np.testing.assert_allclose(made.velocity, solved.velocity, atol=1e-6)
    for one, two in ((made, solved), (solved, made)):
        apart = torch.cdist(one.solid_position, two.solid_position).amin(dim=1)
        assert apart.max() < 2 * 0.05 * 1.01
    np.testing.assert_allclose(made.scene.domain_lower, solved.scene.domain_lower, atol=1e-5)
    assert torch.equal(made.scene.values, solved.scene.values)


def test_a_mesh_of_fluid_is_filled(tmp_path: Path, scene: dict[str, Any]) -> None:
    del scene["FluidBlocks"]
    scene["FluidModels"] = [{"particleFile": "box.obj", "translation": [0.2, 0, 2.5],
                             "scale": [0.3, 0.4, 0.5]}]  # fmt: skip
    lattice_start(scene_job(tmp_path, scene, "lattice.h5"))
    state = read(tmp_path / "lattice.h5")
    assert len(state) == 3 * 4 * 5
    np.testing.assert_allclose(state.position.amin(dim=0), [0.25, 0.05, 2.55], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"Configuration": {"particleRadius": 0.05, "sim2D": True}}, "in two dimensions; install"),
        ({"FluidModels": [{"particleFile": "a.bgeo"}]}, r"only the solver reads a.bgeo; install"),
        ({"FluidModels": [{"particleFile": "none.obj"}]}, r"none.obj: there is no such file"),
        ({"Configuration": {"particleRadius": 0.5}}, "no particle of 0.5 m fits into the fluid"),
    ],
)
def test_what_lattices_cannot_sample(
    tmp_path: Path, scene: dict[str, Any], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        lattice_start(scene_job(tmp_path, {**scene, **changes}, "lattice.h5"))
    assert not (tmp_path / "lattice.h5").exists()


@needs_solver
def test_a_solver_that_fails_is_named(tmp_path: Path, scene: dict[str, Any]) -> None:
    scene["FluidBlocks"][0]["end"] = [0.05, 0.6, 3.55]
    with pytest.raises(UserError, match=r"could not sample the scene: .* left through a wall"):
        solver_start(scene_job(tmp_path, scene, "solver.h5"))
    assert [it.name for it in tmp_path.glob("*.tmp")] == []


def test_what_of_a_scene_is_left_out(tmp_path: Path, scene: dict[str, Any]) -> None:
    scene["Materials"] = [{"viscosityMethod": 6, "vorticityMethod": 1}]
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    told = SceneFile.find(str(tmp_path / "scene.json")).unknown_methods()
    assert len(told) == 2 and "another method" in told[0] and "vorticity is left out" in told[1]
