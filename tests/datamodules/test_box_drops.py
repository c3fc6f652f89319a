"""Tests of the scenes of bodies of random shape in boxes of random size."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.spatial import KDTree
from tetrahedron import write_tetrahedron

from datamodules.generate.bodies import MovingBody, describe, from_description
from datamodules.generate.box_drops import BoxDrops
from datamodules.generate.dataset import generate
from datamodules.generate.job import SolverName
from datamodules.generate.recipe import Recipe
from datamodules.generate.scenes import CLEARANCE, DrawnScene
from datamodules.generate.shapes import Ball, Cuboid, Mesh, Points, Torus
from datamodules.schema import SceneAttributes, validate
from fluidsnet.errors import UserError

RADIUS = 0.025
SEEDS = 60

#: Coarse and small, for the solver.
SMALL = BoxDrops(
    width=(1.0, 1.5),
    height=(1.0, 1.0),
    depth=(0.8, 1.0),
    bodies=(2, 2),
    volume=(0.08, 0.12),
    viscosity=(0.01, 0.1),
)
RECIPE = Recipe(
    scene=SMALL,
    particle_radius=0.04,
    train=3,
    val=0,
    test=1,
    frames=4,
    frame_interval=0.02,
    solver="DFSPH",
)


def bodies(scene: DrawnScene) -> list[MovingBody]:
    moving = [body for body in scene.bodies if isinstance(body, MovingBody)]
    assert len(moving) == len(scene.bodies)
    return moving


def particles(scene: DrawnScene, radius: float = RADIUS) -> list[Points]:
    return [body.particles(radius) for body in bodies(scene)]


@pytest.fixture(scope="module")
def scenes() -> list[DrawnScene]:
    return [BoxDrops().sample(np.random.default_rng(seed), RADIUS) for seed in range(SEEDS)]


def test_boxes_differ_in_their_width_alone(scenes: list[DrawnScene]) -> None:
    domains = np.array([scene.domain for scene in scenes])
    assert (domains[:, 0] >= 2).all() and (domains[:, 0] <= 4).all()
    assert np.ptp(domains[:, 0]) > 1.5
    assert (domains[:, 1:] == 2).all()


def test_particles_are_inside_the_walls_and_one_spacing_apart(scenes: list[DrawnScene]) -> None:
    clear = (1 + CLEARANCE) * RADIUS - 1e-6
    for scene in scenes:
        found = particles(scene)
        position = np.concatenate(found)
        assert (position > clear).all()
        assert (position < np.array(scene.domain) - clear).all()
        distances, _ = KDTree(position).query(position, k=2)
        assert distances[:, 1].min() > 2 * RADIUS * (1 - 1e-6)
        # Between two bodies there is a spacing of air.
        for number, one in enumerate(found):
            for other in found[:number]:
                assert KDTree(one).query(other)[0].min() > 4 * RADIUS * (1 - 1e-6)


def test_there_are_one_to_three_bodies_of_every_shape(scenes: list[DrawnScene]) -> None:
    numbers = [len(scene.bodies) for scene in scenes]
    assert set(numbers) == {1, 2, 3}
    shapes = [body.shape for scene in scenes for body in bodies(scene)]
    balls = [shape for shape in shapes if isinstance(shape, Ball)]
    assert {type(shape) for shape in shapes} == {Cuboid, Ball, Torus}
    assert {len(ball.harmonics) for ball in balls} == {0, 12}
    counts = [len(np.concatenate(particles(scene))) for scene in scenes]
    assert min(counts) > 3500 and max(counts) < 7500
    assert np.ptp(counts) > 1500


def test_places_turns_and_velocities_are_random(scenes: list[DrawnScene]) -> None:
    drawn = [body for scene in scenes for body in bodies(scene)]
    speed = np.linalg.norm([body.velocity for body in drawn], axis=1)
    assert speed.min() < 0.2 and 1.3 < speed.max() <= 1.5
    # All directions are equally likely.
    directions = np.array([body.velocity for body in drawn]) / speed[:, None]
    assert np.abs(directions.mean(axis=0)).max() < 4 / np.sqrt(3 * len(drawn))
    turns = np.array([body.rotation for body in drawn])
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1)
    assert np.abs(turns.mean(axis=0)).max() < 4 / np.sqrt(4 * len(drawn))


def test_one_seed_one_scene_and_one_description(scenes: list[DrawnScene]) -> None:
    assert BoxDrops().sample(np.random.default_rng(3), RADIUS) == scenes[3]
    for scene in scenes:
        text = json.dumps([*map(describe, scene.bodies)])
        assert [*map(from_description, json.loads(text))] == scene.bodies


def test_the_viscosity_is_the_recipes_or_its_logarithm_is_uniform(
    scenes: list[DrawnScene],
) -> None:
    assert all(scene.viscosity is None for scene in scenes)
    random = np.random.default_rng(0)
    drawn = [SMALL.sample(random, 0.04).viscosity or np.nan for _ in range(100)]
    assert min(drawn) >= 0.01 and max(drawn) <= 0.1
    assert np.mean(np.log10(drawn)) == pytest.approx(-1.5, abs=0.12)


@pytest.mark.parametrize("in_folder", [True, False])
def test_meshes_of_the_user(tmp_path: Path, in_folder: bool) -> None:
    path = tmp_path / "tetrahedron.obj"
    write_tetrahedron(path)
    kind = BoxDrops(meshes=[tmp_path if in_folder else path])
    drawn = [kind.sample(np.random.default_rng(seed), RADIUS) for seed in range(12)]
    shapes = [body.shape for scene in drawn for body in bodies(scene)]
    assert {type(shape) for shape in shapes} == {Cuboid, Ball, Mesh}
    assert {shape.path for shape in shapes if isinstance(shape, Mesh)} == {str(path)}
    assert not any(isinstance(shape, Ball) and shape.harmonics for shape in shapes)
    for scene in drawn:
        text = json.dumps([*map(describe, scene.bodies)])
        assert [*map(from_description, json.loads(text))] == scene.bodies


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"width": (3.0, 2.0)}, r"width of BoxDrops is \[3.0, 2.0\]"),
        ({"height": (0.0, 2.0)}, "height of BoxDrops"),
        ({"bodies": (0, 2)}, "bodies of BoxDrops"),
        ({"speed": (-1.0, 2.0)}, "speed of BoxDrops .* at least zero"),
        ({"viscosity": (0.0, 0.1)}, "viscosity of BoxDrops .* above zero"),
        ({"volume": (0.5, np.inf)}, "volume of BoxDrops"),
        ({"meshes": [Path("nowhere.obj")]}, "nowhere.obj: there is no such file"),
    ],
)
def test_what_cannot_be_drawn_is_an_error(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        BoxDrops(**changes)


def test_a_folder_without_meshes_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no OBJ file in this folder"):
        BoxDrops(meshes=[tmp_path])


def test_bodies_without_a_place_are_an_error() -> None:
    full = replace(SMALL, volume=(0.7, 0.7))
    with pytest.raises(UserError, match="finds no place for its bodies in a box"):
        full.sample(np.random.default_rng(0), 0.04)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, real_solver: None) -> Path:
    root = tmp_path_factory.mktemp("made") / "drops"
    assert generate(RECIPE, root, processes=2) == []
    return root


def test_a_file_has_boxes_and_viscosities_of_its_simulations(made: Path) -> None:
    validate(made / "train.h5")
    starts = RECIPE.starts()
    with h5py.File(made / "train.h5") as file:
        found = [SceneAttributes.read(group) for group in file.values()]
        assert not {"domain_upper", "viscosity"} & set(file.attrs)
        assert "viscosity" not in json.loads(file.attrs["solver_parameters"])
        for number, (scene, group) in enumerate(zip(found, file.values(), strict=True)):
            drawn = starts["train", number]
            assert scene.domain_upper == drawn.domain and scene.domain_lower == (0, 0, 0)
            assert scene.viscosity == drawn.viscosity
            solid = group["solid_position"][()]
            np.testing.assert_allclose(solid.max(axis=0), drawn.domain, atol=1e-6)
    assert len({scene.domain_upper for scene in found}) == RECIPE.train
    assert len({scene.viscosity for scene in found}) == RECIPE.train


def test_the_first_frame_has_the_drawn_particles_and_their_velocity(made: Path) -> None:
    starts = RECIPE.starts()
    with h5py.File(made / "train.h5") as file:
        for number, group in enumerate(file.values()):
            drawn = bodies(starts["train", number])
            expected = [body.particles(RECIPE.particle_radius) for body in drawn]
            np.testing.assert_allclose(group["position"][0], np.concatenate(expected), atol=1e-6)
            velocity = np.repeat([body.velocity for body in drawn], [*map(len, expected)], axis=0)
            np.testing.assert_allclose(group["velocity"][0], velocity, atol=1e-6)


@pytest.mark.usefixtures("real_solver")
@pytest.mark.parametrize("solver", ["DFSPH", "IISPH"])
def test_bodies_start_at_rest_density(solver: SolverName, tmp_path: Path) -> None:
    # Without gravity a body at rest stays so; one that is too dense bursts.
    recipe = replace(
        RECIPE, scene=replace(SMALL, speed=(0.0, 0.0)), gravity=(0.0, 0.0, 0.0), solver=solver
    )
    assert generate(recipe, tmp_path, processes=2) == []
    with h5py.File(tmp_path / "train.h5") as file:
        for group in file.values():
            assert np.abs(group["velocity"][()]).max() < 1e-4
            assert np.abs(group["position"][-1] - group["position"][0]).max() < 1e-5
