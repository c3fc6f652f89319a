"""Tests of rollout metrics against cases by hand and against SciPy and POT."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from datamodules import SPHDataModule
from fluidsnet.baselines import Baselines
from fluidsnet.integrator import Displacement, Euler
from fluidsnet.metrics import (
    CenterOfMass,
    Chamfer,
    Density,
    DensityError,
    Escaped,
    KineticEnergy,
    MSEn,
    NonFinite,
    RolloutMetric,
    RolloutPositionError,
    RolloutSuite,
    RolloutVelocityMSE,
    Sinkhorn,
)
from fluidsnet.metrics.density import cubic_spline
from fluidsnet.metrics.point_clouds import SAMPLE, sinkhorn_divergence
from fluidsnet.neighbors import BruteForce
from fluidsnet.particles import Particles
from fluidsnet.scene import Scene

Make = Callable[..., Particles]
METRICS: tuple[type[RolloutMetric], ...] = (
    RolloutPositionError, MSEn, RolloutVelocityMSE, Chamfer, Sinkhorn, KineticEnergy, CenterOfMass,
    DensityError, Escaped, NonFinite,
)  # fmt: skip


def measured(
    kind: type[RolloutMetric], start: Particles, *states: tuple[Particles, Particles]
) -> list[list[float]]:
    """Return the results of a metric after each step, for pairs of predicted and true states."""
    metric = kind([0], len(states)).to(start.position.device)
    for step, (predicted, true) in enumerate(states, start=1):
        metric.update(0, step, predicted, true, start)
    figures = metric.compute()
    return [figures[name].reshape(-1).tolist() for name in metric.names]


def shifted(state: Particles, *offset: float) -> Particles:
    by = torch.tensor(offset, device=state.position.device)
    return state.moved(state.position + by, state.velocity)


def pushed(state: Particles, *change: float) -> Particles:
    by = torch.tensor(change, device=state.position.device)
    return state.moved(state.position, state.velocity + by)


def test_position_error_in_mm_and_in_radii(make_particles: Make) -> None:
    start = make_particles((5, 0))
    states = ((shifted(start, 0.003, 0, 0.004), start), (shifted(start, 0, 0.1, 0), start))
    mm, radii = measured(RolloutPositionError, start, *states)
    assert mm == pytest.approx([5, 100], rel=1e-4)
    assert radii == pytest.approx([0.1, 2], rel=1e-4)


def test_mse_n_is_over_the_first_n_steps_and_the_axes(make_particles: Make) -> None:
    start = make_particles((5, 0))
    states = [(shifted(start, 0, by, 0), start) for by in (0.3, 0.0, 0.6)]
    (found,) = measured(MSEn, start, *states)
    # 0.09 / 3 = 0.03 after the first, 0.36 / 3 = 0.12 in the last alone.
    assert found == pytest.approx([0.03, 0.015, 0.05], rel=1e-4)


def test_velocity_mse_is_that_of_the_step(make_particles: Make) -> None:
    start = make_particles((5, 0))
    (found,) = measured(RolloutVelocityMSE, start, (pushed(start, 3, 0, 0), start), (start, start))
    assert found == pytest.approx([3, 0], rel=1e-4)


def test_kinetic_energy_by_hand(make_particles: Make) -> None:
    rest = make_particles((4, 0))
    rest = rest.moved(rest.position, torch.zeros_like(rest.velocity))
    states = ((rest, rest), (pushed(rest, 0, 1, 0), pushed(rest, 2, 0, 0)), (rest, rest))
    error, energy = measured(KineticEnergy, rest, *states)
    # ½ and 2 J/kg; what is at rest where the truth is at rest is not wrong.
    assert error == pytest.approx([0, 0.75, 0.75])
    assert energy == pytest.approx([0, 0.5, 0])


def test_center_of_mass_is_relative_to_the_way_it_went(make_particles: Make) -> None:
    start = make_particles((4, 0))
    states = (
        (shifted(start, 0.1, 0, 0), shifted(start, 0.1, 0, 0.05)),
        (shifted(start, 0, 0.3, 0), shifted(start, 0, 0.3, 0)),
    )
    (found,) = measured(CenterOfMass, start, *states)
    way = math.hypot(0.1, 0.05)
    assert found == pytest.approx([0.05 / way, 0.05 / (way + 0.3)], rel=1e-4)
    # Particles that change places do not move the center.
    (swapped,) = measured(CenterOfMass, start, (start.moved(start.position.flip(0),
                                                            start.velocity), start))  # fmt: skip
    assert swapped == pytest.approx([0], abs=1e300)


def test_escaped_and_non_finite_by_hand(make_particles: Make) -> None:
    start = make_particles((4, 0))
    out, broken = start.position.clone(), start.velocity.clone()
    out[0, 1] = 1.0 + 0.06
    out[1, 1] = 1.0 + 0.04
    broken[2, 0] = torch.nan
    states = [
        (start.moved(out, start.velocity), start),
        (start.moved(start.position, broken), start),
        (start, start),
    ]
    assert measured(Escaped, start, *states) == [[0.25, 0, 0]]
    assert measured(NonFinite, start, *states) == [[0, 1, 1]]
    metric = NonFinite([3, 4], 3).to(out.device)
    for rollout, steps in ((0, 3), (1, 1)):
        for step in range(steps):
            metric.update(rollout, step + 1, *states[step], start)
    found = metric.compute()
    assert found["simulations"].tolist() == [2, 1, 1]
    assert found["non_finite_step"].tolist() == [2, torch.inf]
    assert found["non_finite"].tolist() == [0, 1, 1]


def test_chamfer_by_hand_and_over_all_pairs(make_particles: Make) -> None:
    start = make_particles((2, 0))
    line = start.position.new_tensor([[0.1, 0.1, 0.1], [0.5, 0.1, 0.1]])
    moved = start.position.new_tensor([[0.4, 0.1, 0.1], [0.5, 0.3, 0.1]])
    true, predicted = start.moved(line, start.velocity), start.moved(moved, start.velocity)
    # There: 0.1 and 0.2 m to the second; back: 0.3 and 0.1 m to the first.
    assert measured(Chamfer, start, (predicted, true))[0] == pytest.approx([175], rel=1e-5)
    here, there = make_particles((700, 0), seed=1), make_particles((700, 0), seed=2)
    x, y = (state.position.cpu().numpy().astype(np.float64) for state in (here, there))
    distance = np.linalg.norm(x[:, None] - y, axis=2)
    expected = 500 * (distance.min(axis=0).mean() + distance.min(axis=1).mean())
    assert measured(Chamfer, here, (here, there))[0] == pytest.approx([expected], rel=1e-5)


def test_sinkhorn_of_a_shifted_fluid_is_the_square_of_the_shift(make_particles: Make) -> None:
    true = make_particles((600, 0))
    for by in (0.0, 0.02, 0.5):
        (found,) = measured(Sinkhorn, true, (shifted(true, by, 0, 0), true))
        assert found == pytest.approx([by**2], rel=1e-3, abs=1e-12)
    # Who goes where does not matter to it.
    few = make_particles((SAMPLE, 0))
    order = torch.randperm(SAMPLE).to(few.position.device)
    mixed = few.moved(few.position[order], few.velocity[order])
    assert measured(Sinkhorn, few, (mixed, few))[0] == pytest.approx([0], abs=1e-9)


def test_sinkhorn_with_little_entropy_is_the_assignment_that_costs_least(
    make_particles: Make,
) -> None:
    x, y = (make_particles((40, 0), seed=seed).position.double() for seed in (1, 2))
    cost = (x[:, None] - y[None]).square().sum(dim=2).cpu().numpy()
    expected = cost[linear_sum_assignment(cost)].mean()
    assert float(sinkhorn_divergence(x, y, 0.02, 3000)) == pytest.approx(expected, rel=0.02)


def test_sinkhorn_is_that_of_pot(make_particles: Make) -> None:
    ot = pytest.importorskip("ot", reason="POT is not installed; it is in the extra `dev`")
    x, y = (make_particles((60, 0), seed=seed).position.double() for seed in (1, 2))
    y, epsilon = 0.7 * y, 0.2**2

    def transport(x: Tensor, y: Tensor) -> float:
        cost, even = ot.dist(x.cpu().numpy(), y.cpu().numpy()), np.full(60, 1 / 60)
        plan = ot.sinkhorn(
            even, even, cost, epsilon, method="sinkhorn_log", numItermax=50_000, stopThr=1e-12
        )
        return float((plan * cost).sum() + epsilon * (plan * np.log(plan * 60**2)).sum())

    expected = transport(x, y) - (transport(x, x) + transport(y, y)) / 2
    assert float(sinkhorn_divergence(x, y, 0.2)) == pytest.approx(expected, rel=1e-3)


def test_the_kernel_sums_to_one_and_ends_at_the_support_radius() -> None:
    r = torch.linspace(0, 0.4, 20_001, dtype=torch.float64)
    weight = cubic_spline(r, 0.2)
    assert float(torch.trapezoid(4 * math.pi * r**2 * weight, r)) == pytest.approx(1, rel=1e-6)
    assert (weight[10_000:] == 0).all() and (weight[:10_000] > 0).all()
    # Monaghan's: 8/πh³ at the center, 2/πh³ half way.
    assert weight[[0, 5_000]].tolist() == pytest.approx([8 / math.pi / 0.008, 2 / math.pi / 0.008])


def test_density_by_hand(scene: Scene, device: torch.device) -> None:
    # Two particles half a support radius apart; two solids, one in reach of the first alone.
    place = torch.tensor([[0.5, 0.5, 0.5], [0.6, 0.5, 0.5]], device=device)
    walls = torch.tensor([[0.4, 0.5, 0.5], [0.35, 0.5, 0.5]], device=device)
    state = Particles.single(place, torch.zeros_like(place), walls, scene)

    def weight(distance: float) -> float:
        return float(cubic_spline(torch.tensor(distance, dtype=torch.float64), 0.2))

    solid = 1 / (weight(0) + weight(0.05))
    first = 0.1**3 * (weight(0) + weight(0.1)) + solid * (weight(0.1) + weight(0.15))
    second = 0.1**3 * (weight(0) + weight(0.1))
    assert Density()(state).tolist() == pytest.approx([first, second], rel=1e-5)
    broken = state.moved(place * place.new_tensor([[1.0], [torch.nan]]), state.velocity)
    assert Density()(broken).isnan().tolist() == [False, True]


def test_density_of_the_solvers_own_frames_is_rest_density(sample: Path) -> None:
    starts = SPHDataModule(sample, voxel_size=0.25).rollout_starts("test", (0, 20))
    for index in (0, 1):
        state = starts[index].state
        density = Density()(state)
        assert torch.allclose(density, Density(BruteForce(256))(state), rtol=1e-5)
        assert float(density.quantile(0.9)) == pytest.approx(1, abs=0.01)


def test_density_error_by_hand(scene: Scene, device: torch.device) -> None:
    # A thousand particles far from each other, two of them in one place with a third.
    grid = torch.cartesian_prod(*(torch.arange(10.0),) * 3).to(device)
    state = Particles.single(grid, torch.zeros_like(grid), grid[:0], scene)
    own = 0.1**3 * 8 / math.pi / 0.2**3
    crowd = grid.clone()
    # Eight in one place: 8 · 0.318 = 2.55 times too dense; alone, 0.318: no excess.
    crowd[:8] = grid[0]
    excess = 8 * own - 1
    mean, percentile = measured(DensityError, state, (state.moved(crowd, crowd), state))
    assert mean == pytest.approx([0.008 * excess], rel=1e-5)
    # The 99.9th percentile of 1,000 lies among the last eight.
    assert percentile == pytest.approx([excess], rel=1e-5)
    assert measured(DensityError, state, (state, state)) == [[0], [0]]


@pytest.mark.parametrize("kind", METRICS)
@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_what_is_not_finite_is_infinite_or_counted(
    kind: type[RolloutMetric], value: float, make_particles: Make
) -> None:
    true = make_particles((300, 50))
    position, velocity = true.position.clone(), true.velocity.clone()
    position[7, 1] = velocity[7, 2] = value
    for figure in measured(kind, true, (true.moved(position, velocity), true)):
        expected = {Escaped: 1 / 300, NonFinite: 1.0}.get(kind, torch.inf)
        assert figure == pytest.approx([expected])


@pytest.mark.parametrize("kind", METRICS)
def test_a_finite_particle_however_far_does_not_break_a_metric(
    kind: type[RolloutMetric], make_particles: Make
) -> None:
    start = make_particles((300, 50))
    true = shifted(start, 0.01, 0, 0)
    position = true.position.clone()
    position[7, 1] = 1e15
    figures = measured(kind, start, (true.moved(position, true.velocity), true))
    assert np.isfinite(figures).all()


def test_a_simulation_weighs_the_same_however_many_rollouts_and_who_is_short_drops_out(
    make_particles: Make,
) -> None:
    start = make_particles((3, 0))
    metric = RolloutPositionError([5, 5, 2], 3).to(start.position.device)
    for rollout, errors in enumerate(((1, 2, 3), (3,), (10, 20))):
        for step, error in enumerate(errors, start=1):
            metric.update(rollout, step, shifted(start, error / 1000, 0, 0), start, start)
    found = metric.compute()["position_error_mm"].tolist()
    assert found == pytest.approx([(2 + 10) / 2, (2 + 20) / 2, 3], rel=1e-3)


def test_the_suite_takes_costly_metrics_where_it_is_told_to(make_particles: Make) -> None:
    start = make_particles((30, 5))
    suite = RolloutSuite([0], 3, {2}, start.position.device)
    for step in (1, 2, 3):
        states = {"model": start, "truth": start}
        suite.update(0, step, states, start, start)
    found = suite.compute()
    assert found["model"]["chamfer_mm"].isnan().tolist() == [True, False, True]
    assert not found["model"]["position_error_mm"].isnan().any()
    assert found["ballistic"]["position_error_mm"].isnan().all()
    assert "position_error_mm" not in found["truth"]
    suite.forget("model")
    again = suite.compute()
    assert again["model"]["position_error_mm"].isnan().all()
    assert not again["truth"]["escaped"].isnan().any()


def test_more_than_one_frame_is_refused(make_particles: Make) -> None:
    two = make_particles((3, 0), (3, 0))
    with pytest.raises(ValueError, match="one frame, not 2"):
        Escaped([0], 1).update(0, 1, two, two, two)


def test_baselines_feed_the_true_motion_back(make_particles: Make) -> None:
    start = make_particles((4, 0))
    for integrator, off in ((Euler(), 1.0), (Displacement(), 0.0)):
        baselines, true = Baselines(start, integrator), start
        for step in (1, 2, 3):
            before, true = true, replace(start, velocity=start.velocity + step)
            true = shifted(true, *(0.02 * (step - 0.5 * off),) * 3)
            states = baselines.after(step, true)
            assert tuple(states) == Baselines.names
            assert torch.equal(states["integrator_floor"].velocity, true.velocity)
            assert before is not true
        expected = start.position + 0.02 * (3 * start.velocity + 6) if off else true.position
        assert torch.allclose(states["integrator_floor"].position, expected, atol=1e-6)
