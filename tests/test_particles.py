"""Tests of the collation of batches, and of what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from fluidsnet.errors import UserError
from fluidsnet.particles import Particles, Transitions
from fluidsnet.scene import Scene

Make = Callable[..., Particles]


def transitions(state: Particles, steps: int = 1) -> Transitions:
    later = torch.arange(steps, device=state.position.device, dtype=torch.float32) + 1
    return Transitions(
        state=state,
        next_position=state.position + later[:, None, None],
        next_velocity=state.velocity - later[:, None, None],
        simulation=torch.arange(state.frames, device=state.position.device),
    )


def test_batches_are_joined_along_their_particles(make_particles: Make) -> None:
    first, second = make_particles((3, 2), (1, 4)), make_particles((2, 0), seed=1)
    batch = Transitions.collate([transitions(first, steps=2), transitions(second, steps=2)])
    state = batch.state
    assert state.frames == 3 and len(state) == 6
    assert state.frame.tolist() == [0, 0, 0, 1, 2, 2]
    assert state.solid_frame.tolist() == [0, 0, 1, 1, 1, 1]
    for name in ("position", "velocity", "solid_position", "solid_velocity"):
        parts = getattr(first, name), getattr(second, name)
        assert torch.equal(getattr(state, name), torch.cat(parts))
    assert batch.next_position.shape == batch.next_velocity.shape == (2, 6, 3)
    assert torch.equal(batch.next_position[1], state.position + 2)
    assert torch.equal(batch.next_velocity[0], state.velocity - 1)
    assert batch.simulation.tolist() == [0, 1, 0]
    assert len(state.scene) == 3 and state.scene.names == ("scene",) * 3


def test_frames_of_different_scenes_keep_their_own(make_particles: Make, scene: Scene) -> None:
    moon = Scene.single(
        (0.0, 0.0, 0.0), (3.0, 1.0, 1.5), (0.0, 0.0, -1.6), 0.05, 0.2, 0.02, viscosity=0.3,
        name="moon", device=scene.gravity.device,
    )  # fmt: skip
    first, other = make_particles((3, 2)), replace(make_particles((2, 1)), scene=moon)
    batch = Particles.collate([first, other])
    assert batch.scene.names == ("scene", "moon")
    assert batch.scene.edges == ((1.5, 1.0, 1.5), (3.0, 1.0, 1.5))
    assert batch.scene.viscosity.tolist() == pytest.approx([0.0, 0.3])
    gravity = batch.per_particle(batch.scene.gravity)
    assert torch.equal(gravity[:3], scene.gravity.expand(3, -1))
    assert torch.equal(gravity[3:], moon.gravity.expand(2, -1))
    assert torch.equal(first.per_particle(first.scene.gravity), scene.gravity)


def test_boxes_of_other_edges_are_named(make_particles: Make, scene: Scene) -> None:
    other = Scene.single((1.0, 0.0, 0.0), (4.0, 1.0, 1.5), (0.0, -9.81, 0.0), 0.05, 0.2, 0.02)
    other = replace(other, names=("wide",)).to(scene.gravity.device)
    shifted = replace(
        scene, domain_lower=scene.domain_lower + 1, domain_upper=scene.domain_upper + 1
    )
    Scene.collate([scene, shifted]).check_one_box("GlobalVector")
    assert scene.joins(shifted) and not scene.joins(other)
    match = r"GlobalVector .*scene \(1.5 x 1 x 1.5 m\) and wide \(3 x 1 x 1.5 m\)"
    with pytest.raises(UserError, match=match):
        Scene.collate([scene, other]).check_one_box("GlobalVector")


@pytest.mark.parametrize(
    ("field", "change", "values"),
    [
        ("gravity", torch.zeros(1, 3).double(), "torch.float32 and torch.float64"),
        ("particle_radius", 0.03, "0.05 and 0.03"),
        ("support_radius", 0.3, "0.2 and 0.3"),
        ("time_step", 0.04, "0.02 and 0.04"),
    ],
)
def test_different_resolutions_and_time_steps_are_not_mixed(
    make_particles: Make, scene: Scene, field: str, change: Any, values: str
) -> None:
    state = make_particles((3, 2))
    change = change.to(scene.gravity.device) if isinstance(change, torch.Tensor) else change
    other = replace(state, scene=replace(scene, **{field: change}))
    with pytest.raises(ValueError, match=rf"cannot collate .*{field}.* is {values}"):
        Particles.collate([state, state, other])
    with pytest.raises(ValueError, match=rf"cannot collate .*{field}"):
        Transitions.collate([transitions(state), transitions(other)])


def test_different_numbers_of_steps_are_not_mixed(make_particles: Make) -> None:
    state = make_particles((3, 2))
    match = r"collate next_position: its shape is \(1, N, 3\) and \(2, N, 3\)"
    with pytest.raises(ValueError, match=match):
        Transitions.collate([transitions(state, steps=1), transitions(state, steps=2)])


@pytest.mark.parametrize("field", ["position", "velocity", "solid_position", "frame"])
def test_different_dtypes_are_not_mixed(make_particles: Make, field: str) -> None:
    state = make_particles((3, 2))
    other = replace(state, **{field: getattr(state, field).half()})
    match = rf"collate {field}: its dtype is torch\.(float32|int64) and torch\.float16"
    with pytest.raises(ValueError, match=match):
        Particles.collate([state, other])


def test_different_devices_are_not_mixed(make_particles: Make, device: torch.device) -> None:
    state = make_particles((3, 2))
    match = rf"collate position: its device is {device.type}\S* and meta"
    with pytest.raises(ValueError, match=match):
        Particles.collate([state, state.to("meta")])


def test_nothing_is_not_a_batch() -> None:
    with pytest.raises(ValueError, match="there are no batches"):
        Transitions.collate([])
