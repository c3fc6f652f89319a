"""Share of the fluid's volume that is elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from fluidsnet.metrics import MisplacedVolume
from fluidsnet.particles import Particles
from fluidsnet.scene import Scene


def misplaced(predicted: Particles, true: Particles) -> float:
    metric = MisplacedVolume([0], 1).to(true.position.device)
    metric.update(0, 1, predicted, true, true)
    return float(metric.compute()["misplaced_volume"])


def block(scene: Scene, radius: float, edge: float = 0.8, corner: float = 0.1) -> Particles:
    axis = torch.arange(corner + radius, corner + edge, 2 * radius, dtype=torch.float64)
    place = torch.cartesian_prod(axis, axis, axis).float().to(scene.domain_lower.device)
    sized = replace(scene, particle_radius=radius, support_radius=4 * radius)
    return Particles.single(place, torch.zeros_like(place), place[:0], sized)


def test_zero_for_the_truth_in_any_order(make_particles: Callable[..., Particles]) -> None:
    state = make_particles((200, 0))
    order = torch.randperm(200, device=state.position.device)
    assert misplaced(state, state) < 1e-12
    assert misplaced(state.moved(state.position[order], state.velocity), state) < 1e-12


def test_one_where_nothing_is_in_common(make_particles: Callable[..., Particles]) -> None:
    state = make_particles((200, 0))
    for shift in (3.0, 1e9):
        away = state.moved(state.position + shift, state.velocity)
        assert misplaced(away, state) == pytest.approx(1)


def test_the_share_of_a_block_that_is_shifted(scene: Scene) -> None:
    state = block(scene, 0.05)
    # By a cell, 0.4 m, of the two that the block is wide: half of it, less what its edges spread.
    moved = state.moved(
        state.position + torch.tensor([0.4, 0, 0]).to(state.position), state.velocity
    )
    assert misplaced(moved, state) == pytest.approx(0.5, abs=0.03)


def test_larger_particles_fill_the_same_cells(scene: Scene) -> None:
    fine, coarse = block(scene, 0.025), block(scene, 0.05)
    assert len(fine.position) == 8 * len(coarse.position)
    assert misplaced(coarse, fine) < 0.02
    half = block(scene, 0.05, edge=0.4)
    assert misplaced(half, fine) == pytest.approx((1 - 0.125) / 2, abs=0.05)


def test_a_state_that_is_not_finite_is_infinitely_wrong(
    make_particles: Callable[..., Particles],
) -> None:
    state = make_particles((10, 0))
    lost = state.position.clone()
    lost[3, 1] = torch.nan
    assert misplaced(state.moved(lost, state.velocity), state) == torch.inf
