"""Tests of the augmentation by symmetries of a box."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from datamodules import SPHDataModule
from datamodules.augmentation import Augmentation, BoxSymmetry
from fluidsnet.errors import UserError
from fluidsnet.particles import Particles, SolidStates, Transitions
from fluidsnet.scene import Scene

Make = Callable[..., Particles]

DRAWS = 100  # one of eight symmetries stays away that often once in a million


@pytest.fixture
def transitions(make_particles: Make, scene: Scene) -> Transitions:
    """Return a state and two next ones, in a box whose lower corner is not the origin."""
    state = make_particles((60, 15))
    shift = torch.tensor([-0.3, 0.2, 1.0], device=state.position.device)
    moved_scene = replace(
        scene, domain_lower=scene.domain_lower + shift, domain_upper=scene.domain_upper + shift
    )
    state = replace(
        state,
        position=state.position + shift,
        solid_position=state.solid_position + shift,
        solid_velocity=torch.randn_like(state.solid_position),
        scene=moved_scene,
    )
    steps = torch.arange(1, 3, device=shift.device)[:, None, None] * scene.time_step
    return Transitions(
        state=state,
        next_position=state.position + steps * state.velocity,
        next_velocity=state.velocity.expand(2, -1, -1) + steps * scene.gravity,
        simulation=torch.arange(state.frames),
    )


def in_box(transitions: Transitions, upper: tuple[float, float, float]) -> Transitions:
    """Return the sample in a box of other edges."""
    scene = transitions.state.scene
    edges = torch.tensor(upper, device=scene.domain_lower.device)
    scale = edges / scene.extent
    place = lambda position: (position - scene.domain_lower) * scale + scene.domain_lower  # noqa: E731
    state = transitions.state
    other = replace(scene, domain_upper=scene.domain_lower + edges)
    return Transitions(
        state=replace(
            state,
            position=place(state.position),
            solid_position=place(state.solid_position),
            velocity=state.velocity * scale,
            scene=other,
        ),
        next_position=place(transitions.next_position),
        next_velocity=transitions.next_velocity * scale,
        simulation=transitions.simulation,
    )


def draws(transitions: Transitions) -> list[Transitions]:
    torch.manual_seed(0)
    augmentation = BoxSymmetry()
    return [augmentation(transitions) for _ in range(DRAWS)]


def inside(position: Tensor, scene: Scene) -> bool:
    return bool(
        ((position >= scene.domain_lower - 1e-5) & (position <= scene.domain_upper + 1e-5)).all()
    )


BOXES = [(1.5, 1.0, 1.5), (1.5, 1.0, 2.0)]


@pytest.mark.parametrize("upper", BOXES)
def test_the_domain_is_mapped_to_itself(
    transitions: Transitions, upper: tuple[float, float, float]
) -> None:
    before = in_box(transitions, upper)
    for after in draws(before):
        scene = after.state.scene
        assert torch.equal(scene.domain_upper, before.state.scene.domain_upper)
        assert inside(after.state.position, scene)
        assert inside(after.state.solid_position, scene)


def test_a_swap_would_leave_a_box_that_is_not_square(transitions: Transitions) -> None:
    # Otherwise the test above says nothing of the swap.
    before = in_box(transitions, (1.5, 1.0, 2.0))
    center = (before.state.scene.domain_lower + before.state.scene.domain_upper) / 2
    swapped = (before.state.position - center)[:, [2, 1, 0]] + center
    assert not inside(swapped, before.state.scene)


def test_solids_that_move_go_where_their_symmetry_takes_them(transitions: Transitions) -> None:
    start = transitions.state
    steps = torch.arange(1, 3, device=start.position.device)[:, None, None] * start.scene.time_step
    solids = SolidStates(
        start.solid_position + steps * start.solid_velocity, start.solid_velocity.expand(2, -1, -1)
    )
    for after in draws(replace(transitions, solids=solids)):
        assert after.solids is not None
        # Straight on from the mapped start with the mapped velocity, as before.
        torch.testing.assert_close(
            after.solids.position, after.state.solid_position + steps * after.state.solid_velocity
        )
        assert torch.equal(after.solids.velocity[1], after.state.solid_velocity)


def test_distances_to_fluid_and_solids_are_kept(transitions: Transitions) -> None:
    def distances(state: Particles) -> Tensor:
        everything = torch.cat([state.position, state.solid_position]).double()
        return torch.cdist(everything, everything)

    expected = distances(transitions.state)
    for after in draws(transitions):
        torch.testing.assert_close(distances(after.state), expected, atol=1e-5, rtol=0)


def test_the_axis_of_gravity_is_left_alone(transitions: Transitions) -> None:
    for after in draws(transitions):
        torch.testing.assert_close(after.state.position[:, 1], transitions.state.position[:, 1])
        assert torch.equal(after.state.velocity[:, 1], transitions.state.velocity[:, 1])
        assert torch.equal(after.next_velocity[..., 1], transitions.next_velocity[..., 1])
        assert torch.equal(after.state.solid_velocity[:, 1], transitions.state.solid_velocity[:, 1])


def test_velocity_turns_with_the_change_of_position(transitions: Transitions) -> None:
    step = transitions.state.scene.time_step
    for after in draws(transitions):
        for number in range(2):
            moved = after.next_position[number] - after.state.position
            torch.testing.assert_close(
                moved, (number + 1) * step * after.state.velocity, atol=1e-5, rtol=1e-4
            )
            # The change of velocity is gravity's, before as after.
            torch.testing.assert_close(
                after.next_velocity[number] - after.state.velocity,
                ((number + 1) * step * after.state.scene.gravity).expand_as(moved),
                atol=1e-5,
                rtol=1e-4,
            )


def seen(transitions: Transitions) -> set[tuple[float, ...]]:
    return {tuple(after.state.velocity[0].tolist()) for after in draws(transitions)}


def test_all_eight_symmetries_of_a_square_box_occur(transitions: Transitions) -> None:
    x, y, z = transitions.state.velocity[0].tolist()
    expected = {(a * x, y, b * z) for a in (1, -1) for b in (1, -1)}
    expected |= {(a * z, y, b * x) for a in (1, -1) for b in (1, -1)}
    assert seen(transitions) == expected


def test_only_four_where_the_box_is_not_as_wide_as_deep(transitions: Transitions) -> None:
    before = in_box(transitions, (1.5, 1.0, 2.0))
    x, y, z = before.state.velocity[0].tolist()
    assert seen(before) == {(a * x, y, b * z) for a in (1, -1) for b in (1, -1)}


@pytest.mark.parametrize("along", [0, 2])
def test_gravity_may_be_along_another_axis(transitions: Transitions, along: int) -> None:
    gravity = torch.zeros(1, 3, device=transitions.state.position.device)
    gravity[0, along] = 9.81
    before = in_box(transitions, (1.0, 1.0, 1.0))
    state = before.state
    before = replace(before, state=replace(state, scene=replace(state.scene, gravity=gravity)))
    assert len(seen(before)) == 8
    for after in draws(before):
        assert torch.equal(after.state.velocity[:, along], before.state.velocity[:, along])


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (1.0, -9.81, 0.0)])
def test_gravity_along_no_single_axis_is_refused(
    transitions: Transitions, gravity: tuple[float, float, float]
) -> None:
    state = transitions.state
    scene = replace(state.scene, gravity=torch.tensor([gravity], device=state.position.device))
    with pytest.raises(UserError, match="gravity along one axis"):
        BoxSymmetry()(replace(transitions, state=replace(state, scene=scene)))


def test_only_training_is_augmented(sample: Path) -> None:
    class Zero(Augmentation):
        def check(self, scene: Scene) -> None:
            assert len(scene) == 4 and (scene.gravity[:, 1] < 0).all()

        def __call__(self, sample: Transitions) -> Transitions:
            state = sample.state
            return replace(sample, state=state.moved(0 * state.position, 0 * state.velocity))

    data = SPHDataModule(sample, voxel_size=0.25, batch_size=2, augmentation=Zero())
    data.setup("fit")
    data.setup("test")
    assert float(data.statistics.velocity_deviation) > 0.1
    assert not next(iter(data.train_dataloader())).state.position.any()
    assert next(iter(data.val_dataloader())).state.position.any()
    assert next(iter(data.test_dataloader())).state.position.any()
