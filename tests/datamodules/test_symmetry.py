"""Tests that no test or validation simulation mirrors one of the training."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from datamodules.generate.bodies import Block, Body, Drop, MovingBody
from datamodules.generate.command import _parser as generate_parser
from datamodules.generate.recipe import Recipe
from datamodules.generate.scenes import DamBreak, DrawnScene
from datamodules.generate.shapes import Cuboid
from datamodules.generate.symmetry import Symmetries
from datamodules.schema import SPLITS, Header, SceneAttributes
from fluidsnet.errors import UserError

ROOT = Path(__file__).parents[2]
DOWN = (0.0, -9.81, 0.0)
SQUARE, OBLONG = (1.5, 1.0, 1.5), (1.5, 1.0, 1.2)
CORNER = Block((0.1, 0.1, 0.1), (0.5, 0.7, 1.0))


def mirrored(block: Block, domain: tuple[float, float, float], *axes: int) -> Block:
    lower, upper = list(block.lower), list(block.upper)
    for axis in axes:
        lower[axis], upper[axis] = (
            domain[axis] - block.upper[axis],
            domain[axis] - block.lower[axis],
        )
    return Block((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2]))


def swapped(block: Block) -> Block:
    return Block(block.lower[::-1], block.upper[::-1])


def alike(
    domain: tuple[float, float, float],
    first: list[Body],
    second: list[Body],
    distance: float = 1e-6,
    gravity: tuple[float, float, float] = DOWN,
) -> bool:
    """Compare bodies in the same box."""
    return Symmetries(gravity).alike(
        DrawnScene(domain, first), DrawnScene(domain, second), distance
    )


@pytest.mark.parametrize("axes", [(), (0,), (2,), (0, 2)])
def test_a_block_in_any_corner_is_the_same(axes: tuple[int, ...]) -> None:
    for domain in (SQUARE, OBLONG):
        assert alike(domain, [CORNER], [mirrored(CORNER, domain, *axes)])
    turned = swapped(mirrored(CORNER, SQUARE, *axes))
    assert alike(SQUARE, [CORNER], [turned])
    # In a box that is not as wide as it is deep, the two axes are not the same.
    assert not alike(OBLONG, [CORNER], [swapped(CORNER)])


def test_another_block_is_not_the_same() -> None:
    assert not alike(SQUARE, [CORNER], [mirrored(CORNER, SQUARE, 1)]), "upside down"
    for axis in range(3):
        upper = list(CORNER.upper)
        upper[axis] += 0.04
        grown = Block(CORNER.lower, (upper[0], upper[1], upper[2]))
        assert not alike(SQUARE, [CORNER], [grown], 0.02)
        assert alike(SQUARE, [CORNER], [grown], 0.05)


def test_all_bodies_are_mirrored_together() -> None:
    left, right = Drop((0.4, 0.7, 0.5), 0.2), Drop((1.1, 0.7, 0.5), 0.2)
    assert alike(SQUARE, [CORNER, left], [mirrored(CORNER, SQUARE, 0), right])
    assert not alike(SQUARE, [CORNER, left], [CORNER, right])
    assert not alike(SQUARE, [CORNER, left], [CORNER])
    assert not alike(SQUARE, [left], [Drop(left.center, left.radius, "drop.obj")])


def test_the_mirrors_are_those_that_leave_gravity_as_it_is() -> None:
    upright = mirrored(CORNER, SQUARE, 1)
    sideways = mirrored(CORNER, SQUARE, 0)
    assert alike(SQUARE, [CORNER], [upright], gravity=(-9.81, 0.0, 0.0))
    assert not alike(SQUARE, [CORNER], [sideways], gravity=(-9.81, 0.0, 0.0))
    assert not alike(SQUARE, [CORNER], [sideways], gravity=(1.0, -9.0, 0.0))
    # Slanted towards a corner, the swap is left.
    assert alike(SQUARE, [CORNER], [swapped(CORNER)], gravity=(1.0, -9.0, 1.0))
    assert not alike(SQUARE, [CORNER], [sideways], gravity=(1.0, -9.0, 1.0))


def test_boxes_are_compared_too() -> None:
    symmetries, here = Symmetries(DOWN), DrawnScene(OBLONG, [CORNER])
    assert not symmetries.alike(here, DrawnScene(SQUARE, [CORNER]), 0.02)
    assert not symmetries.alike(here, DrawnScene((1.5, 1.2, 1.2), [CORNER]), 0.02)
    # The same box, turned by 90 degrees about the up axis.
    turned = DrawnScene(OBLONG[::-1], [swapped(CORNER)])
    assert symmetries.alike(here, turned, 1e-6) and symmetries.alike(turned, here, 1e-6)
    assert not symmetries.alike(here, DrawnScene(OBLONG[::-1], [CORNER]), 1e-6)


def test_a_moving_body_in_a_mirror_is_the_same() -> None:
    cosine, sine = np.cos(np.pi / 8), np.sin(np.pi / 8)
    left = MovingBody(
        Cuboid((0.4, 0.2, 0.3)), (0.4, 0.5, 0.5), (cosine, 0.0, 0.0, sine), (1.0, 0.0, 0.0)
    )
    right = replace(
        left, center=(1.1, 0.5, 0.5), rotation=(cosine, 0.0, 0.0, -sine), velocity=(-1.0, 0.0, 0.0)
    )
    assert alike(SQUARE, [left], [right])
    assert not alike(SQUARE, [left], [replace(right, rotation=(1.0, 0.0, 0.0, 0.0))])
    assert not alike(SQUARE, [left], [replace(right, shape=Cuboid((0.4, 0.2, 0.4)))])


def pairs_alike(
    recipe: Recipe, starts: dict[tuple[str, int], DrawnScene]
) -> list[tuple[tuple[str, int], tuple[str, int]]]:
    symmetries = Symmetries(recipe.gravity)
    return [
        (first, second)
        for first, second in combinations(starts, 2)
        if symmetries.alike(starts[first], starts[second], recipe.particle_radius)
    ]


def shipped(scene: Path) -> Recipe:
    parser = generate_parser()
    arguments = [f"--config={scene}", "--root=nowhere"]
    options = parser.instantiate(parser.parse_args(arguments))
    return Recipe(**vars(options.recipe))


@pytest.mark.parametrize(
    "scene", sorted((ROOT / "configs" / "scene").glob("*.yaml")), ids=lambda path: path.stem
)
def test_no_shipped_recipe_draws_a_scene_and_its_mirror_image(scene: Path) -> None:
    recipe = shipped(scene)
    starts = recipe.starts()
    assert len(starts) == recipe.train + recipe.val + recipe.test
    assert pairs_alike(recipe, starts) == []


COARSE = Recipe(scene=DamBreak(SQUARE), particle_radius=0.06, train=14, val=1, test=2, frames=2)


def test_training_alone_has_mirror_images_where_nothing_else_is_left() -> None:
    # Eight columns of these, each in four corners.
    for seed in range(3):
        recipe = replace(COARSE, seed=seed)
        starts = recipe.starts()
        assert len(starts) == 17
        alike = pairs_alike(recipe, starts)
        assert alike and all(split == "train" for pair in alike for split, _ in pair)
        scenes = list(starts.values())
        assert all(scenes.count(scene) == 1 for scene in scenes)


def test_what_is_held_out_does_not_depend_on_how_much_is_trained_on() -> None:
    many, few = COARSE.starts(), replace(COARSE, train=1).starts()
    assert all(many[key] == few[key] for key in few if key[0] != "train")


@pytest.mark.parametrize(("train", "val"), [(5, 0), (1, 1), (0, 2)])
def test_too_few_different_scenes_are_an_error(train: int, val: int) -> None:
    scene = DamBreak((1.0, 1.0, 1.0), width=(0.5, 0.5), height=(0.5, 0.5), depth=(0.5, 0.5))
    recipe = replace(COARSE, scene=scene, particle_radius=0.08, train=4, val=0, test=0)
    assert len(recipe.starts()) == 4  # the corners
    with pytest.raises(UserError, match="DamBreak draws too few scenes that are no mirror images"):
        replace(recipe, train=train, val=val).starts()


def by_place(position: NDArray[np.float32]) -> NDArray[np.float64]:
    rounded = np.round(position.astype(np.float64), 4)
    return rounded[np.lexsort(rounded.T)]


def test_the_sample_tests_on_no_mirror_image_of_what_it_trains_on(sample: Path) -> None:
    starts: dict[tuple[str, str], NDArray[np.float32]] = {}
    for split in SPLITS:
        with h5py.File(sample / f"{split}.h5") as file:
            header = Header.read(file)
            for name, group in file.items():
                starts[split, name] = group["position"][0]
                box = SceneAttributes.read(group)
                bodies = json.loads(group.attrs["scene_parameters"])
                assert [body["shape"] for body in bodies] == ["block"]
    middle = (np.array(box.domain_lower) + box.domain_upper) / 2
    for first, second in combinations(starts, 2):
        if len(starts[first]) != len(starts[second]):
            continue
        # The particles themselves, in each of the eight images that BoxSymmetry makes.
        for axes in ([0, 1, 2], [2, 1, 0]):
            for signs in ([1, 1, 1], [-1, 1, 1], [1, 1, -1], [-1, 1, -1]):
                image = (starts[first] - middle)[:, axes] * signs + middle
                apart = np.abs(by_place(image) - by_place(starts[second])).max()
                assert apart > header.particle_radius, f"{first} is {second} in a mirror"
