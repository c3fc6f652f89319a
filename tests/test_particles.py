"""Tests of the collation of batches, and of what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

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
    assert state.scene is first.scene


def test_scenes_of_equal_values_are_one_scene(make_particles: Make) -> None:
    state = make_particles((3, 2))
    copy = replace(state.scene, gravity=state.scene.gravity.clone())
    assert Particles.collate([state, replace(state, scene=copy)]).frames == 2


@pytest.mark.parametrize(
    ("field", "change", "values"),
    [
        (
            "domain_lower",
            torch.tensor([0.0, -1.0, 0.0]),
            r"\[0.0, 0.0, 0.0\] and \[0.0, -1.0, 0.0\]",
        ),
        ("domain_upper", torch.tensor([1.5, 2.0, 1.5]), r"\[1.5, 1.0, .* and \[1.5, 2.0, 1.5\]"),
        ("gravity", torch.zeros(3), r"\[0.0, -9.8\d+, 0.0\] and \[0.0, 0.0, 0.0\]"),
        ("gravity", torch.zeros(3).double(), r"torch.float32.* and .*torch.float64"),
        ("particle_radius", 0.03, "0.05 and 0.03"),
        ("support_radius", 0.3, "0.2 and 0.3"),
        ("time_step", 0.04, "0.02 and 0.04"),
    ],
)
def test_different_scenes_are_not_mixed(
    make_particles: Make, scene: Scene, field: str, change: Any, values: str
) -> None:
    state = make_particles((3, 2))
    change = change.to(scene.gravity.device) if isinstance(change, torch.Tensor) else change
    other = replace(state, scene=replace(scene, **{field: change}))
    with pytest.raises(ValueError, match=rf"different scenes: scene\.{field} is .*{values}"):
        Particles.collate([state, state, other])
    with pytest.raises(ValueError, match=rf"different scenes: scene\.{field}"):
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
