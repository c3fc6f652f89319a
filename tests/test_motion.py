"""Targets, integrators and walls: what a prediction does to a particle."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from fluidsnet.baselines import ballistic, constant_velocity
from fluidsnet.integrator import Displacement, Euler, Integrator, Trapezoid
from fluidsnet.particles import Particles
from fluidsnet.priors import FreeFall
from fluidsnet.statistics import Statistics
from fluidsnet.target import (
    AccelerationTarget,
    DisplacementTarget,
    Motion,
    Target,
    VelocityTarget,
)
from fluidsnet.walls import OpenWalls, StopAtWalls

Make = Callable[..., Particles]


def statistics(device: torch.device) -> Statistics:
    means = torch.tensor([[0.1, -0.5, 0.2], [0.0, -0.1, 0.01], [0.0, -0.002, 0.0]], device=device)
    deviations = torch.tensor([0.7, 0.17, 0.002], device=device)
    return Statistics(means[0], deviations[0], means[1], deviations[1], deviations[2])


@pytest.mark.parametrize("target", [VelocityTarget, AccelerationTarget, DisplacementTarget])
def test_decoding_what_was_encoded_gives_the_truth(
    target: type[Target], make_particles: Make
) -> None:
    state, later = make_particles((50, 0)), make_particles((50, 0), seed=1)
    made = target().to(state.position.device)
    made.set_statistics(statistics(state.position.device))
    guess = FreeFall()(state)
    output = made.encode(state, guess, later.position, later.velocity)
    motion = made.decode(output, state, guess)
    assert output.shape == (50, made.width)
    assert torch.allclose(motion.velocity, later.velocity, atol=1e-5)
    assert made.gives_displacement == (motion.displacement is not None)
    if motion.displacement is not None:
        moved = state.position + motion.displacement
        assert torch.allclose(moved, later.position, atol=1e-5)


def test_a_displacement_target_that_says_nothing_is_free_fall(make_particles: Make) -> None:
    state = make_particles((50, 0))
    target = DisplacementTarget().to(state.position.device)
    nothing = torch.zeros(50, 6, device=state.position.device)
    motion = target.decode(nothing, state, FreeFall()(state))
    expected = ballistic(state)
    assert torch.allclose(Displacement()(state, motion).position, expected.position, atol=1e-6)
    assert torch.allclose(motion.velocity, expected.velocity, atol=1e-6)


@pytest.mark.parametrize(
    ("integrator", "share"),
    # x_n = x_0 + n·Δt·v_0 + share(n)·Δt²·g, each integrator's own discrete free fall.
    [
        (Euler(), lambda n: n * (n + 1) / 2),
        (Trapezoid(), lambda n: n**2 / 2),
        (Displacement(), lambda n: n**2 / 2),
    ],
)
def test_free_fall_is_the_integrators_own_discrete_solution(
    integrator: Integrator, share: Callable[[int], float], make_particles: Make
) -> None:
    start = make_particles((20, 0))
    step, gravity = start.scene.time_step, start.scene.gravity
    state, steps = start, 25
    for _ in range(steps):
        fallen = ballistic(state)
        motion = Motion(fallen.velocity, fallen.position - state.position)
        state = integrator(state, motion)
    expected = start.position + steps * step * start.velocity + share(steps) * step**2 * gravity
    assert torch.allclose(state.position, expected, atol=1e-4)
    assert torch.allclose(state.velocity, start.velocity + steps * step * gravity, atol=1e-4)


def test_displacement_needs_one(make_particles: Make) -> None:
    state = make_particles((2, 0))
    with pytest.raises(ValueError, match="no displacement"):
        Displacement()(state, Motion(state.velocity))


def test_trivial_predictors_over_many_steps(make_particles: Make) -> None:
    state = make_particles((20, 0))
    for predictor in (constant_velocity, ballistic):
        at_once, one_by_one = predictor(state, 5), state
        for _ in range(5):
            one_by_one = predictor(one_by_one)
        assert torch.allclose(at_once.position, one_by_one.position, atol=1e-5)
        assert torch.allclose(at_once.velocity, one_by_one.velocity, atol=1e-5)


def test_walls_stop_what_crosses_them_and_nothing_else(make_particles: Make) -> None:
    state = make_particles((4, 0))
    device = state.position.device
    position = torch.tensor(
        [[-0.1, 0.5, 0.5], [0.7, 0.01, 0.5], [0.7, 0.5, 2.0], [0.7, 0.5, 0.7]], device=device
    )
    velocity = torch.tensor(
        [[-1.0, 2.0, 3.0], [1.0, 5.0, 1.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]], device=device
    )
    stopped = StopAtWalls(clearance=1.0)(state.moved(position, velocity))
    assert torch.allclose(
        stopped.position,
        torch.tensor(
            [[0.05, 0.5, 0.5], [0.7, 0.05, 0.5], [0.7, 0.5, 1.45], [0.7, 0.5, 0.7]],
            device=device,
        ),
    )
    # The second was moved inwards already, and keeps its velocity.
    assert torch.allclose(
        stopped.velocity,
        torch.tensor(
            [[0.0, 2.0, 3.0], [1.0, 5.0, 1.0], [1.0, 2.0, 0.0], [1.0, 2.0, 3.0]], device=device
        ),
    )
    assert OpenWalls()(state) is state
