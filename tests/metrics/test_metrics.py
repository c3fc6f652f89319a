from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from fluidsnet.metrics import PositionError, Skill, VelocityMSE
from fluidsnet.particles import Particles

Make = Callable[..., Particles]


def _numbers(particles: Particles, *numbers: int) -> torch.Tensor:
    """Return the number of the simulation of each frame; all of one by default."""
    return torch.tensor(numbers or (0,) * particles.frames, device=particles.position.device)


def test_velocity_mse_by_hand(make_particles: Make) -> None:
    # A frame of one particle weighs as much as a frame of three.
    particles = make_particles((1, 0), (3, 0))
    true = particles.velocity
    wrong = true.clone()
    wrong[0] += torch.tensor([3.0, 0.0, 0.0], device=true.device)
    wrong[1] += torch.tensor([0.0, 6.0, 0.0], device=true.device)
    metric = VelocityMSE().to(true.device)
    metric.update(wrong, true, particles, _numbers(particles))
    # Frame one: 9 / 3 = 3. Frame two: 36 / 3 = 12, over three particles 4.
    assert float(metric.compute()) == pytest.approx((3 + 4) / 2)


def test_position_error_by_hand(make_particles: Make) -> None:
    particles = make_particles((2, 0), (1, 0))
    wrong = particles.position + torch.tensor([0.003, 0.0, 0.004], device=particles.position.device)
    metric = PositionError().to(wrong.device)
    metric.update(wrong, particles.position, particles, _numbers(particles))
    metric.update(particles.position, particles.position, particles, _numbers(particles))
    assert float(metric.compute()) == pytest.approx(2.5, rel=1e-3)


def test_skill_of_the_trivial_predictors_and_of_the_truth(make_particles: Make) -> None:
    particles = make_particles((40, 0))
    falling = particles.velocity + 0.02 * particles.scene.gravity
    # The truth lies near free fall, so that ballistic is the better of the two.
    true = falling + 0.01 * torch.randn_like(falling)
    for predicted, expected in ((falling, 0.0), (true, 1.0)):
        metric = Skill().to(true.device)
        metric.update(predicted, true, particles, _numbers(particles))
        assert float(metric.compute()) == pytest.approx(expected, abs=1e-5)
    worse = Skill().to(true.device)
    worse.update(particles.velocity, true, particles, _numbers(particles))
    assert float(worse.compute()) < -10


def test_skill_is_over_all_frames_and_not_a_mean_of_skills(make_particles: Make) -> None:
    particles = make_particles((1, 0))
    device = particles.position.device
    still = particles.moved(particles.position, torch.zeros(1, 3, device=device))
    metric = Skill().to(device)
    # Constant velocity is off by 1 and by 3, the prediction by 1 and by 0.
    up = torch.tensor([[0.0, 1.0, 0.0]], device=device)
    metric.update(0 * up, up, still, _numbers(still))
    metric.update(3 * up, 3 * up, still, _numbers(still))
    assert float(metric.compute()) == pytest.approx(1 - 1 / 10)


def test_a_simulation_weighs_the_same_however_many_frames_it_has(make_particles: Make) -> None:
    particles = make_particles((1, 0), (1, 0), (1, 0))
    right, device = particles.velocity, particles.position.device
    # Frames are off by 1, 2 and 6 m/s along each axis; the last is of another simulation.
    wrong = right + torch.tensor([[1.0], [2.0], [6.0]], device=device)
    first, last = VelocityMSE().to(device), VelocityMSE().to(device)
    first.update(wrong, right, particles, _numbers(particles, 4, 4, 9))
    assert float(first.compute()) == pytest.approx(((1 + 4) / 2 + 36) / 2, rel=1e-4)
    # However they come.
    for frame, number in ((2, 9), (0, 4), (1, 4)):
        one = make_particles((1, 0))
        there, offset = one.velocity, wrong[frame] - right[frame]
        last.update(there + offset, there, one, _numbers(one, number))
    assert float(last.compute()) == pytest.approx(float(first.compute()), rel=1e-4)


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_what_is_not_finite_makes_the_metric_infinite(make_particles: Make, value: float) -> None:
    particles = make_particles((3, 0))
    broken = particles.velocity.clone()
    broken[1, 2] = value
    mse, skill = VelocityMSE().to(broken.device), Skill().to(broken.device)
    mse.update(broken, particles.velocity, particles, _numbers(particles))
    skill.update(broken, particles.velocity + 1, particles, _numbers(particles))
    assert float(mse.compute()) == torch.inf
    assert float(skill.compute()) == -torch.inf
