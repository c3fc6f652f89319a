"""Tests of the field data of trajectory files against cases by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from callbacks.trajectory_writer import errors
from fluidsnet.baselines import Baselines
from fluidsnet.integrator import Displacement, Euler
from fluidsnet.particles import Particles

Make = Callable[..., Particles]


def test_errors_by_hand(make_particles: Make) -> None:
    start = make_particles((2, 0))
    device = start.position.device
    still = start.moved(torch.full((2, 3), 0.5, device=device), torch.zeros(2, 3, device=device))
    along = torch.tensor([1.0, 0.0, 0.0], device=device)
    for integrator, floors in ((Euler(), (10.0, 20.0)), (Displacement(), (0.0, 0.0))):
        baselines = Baselines(still, integrator)
        for step, floor in zip((1, 2), floors, strict=True):
            # The truth accelerates from rest: x = t²/2 · 50 m/s², v = t · 50 m/s².
            time = 0.02 * step
            velocity = (50 * time * along).expand(2, 3)
            true = still.moved(still.position + 25 * time**2 * along, velocity)
            escapes = still.position + torch.tensor([[0.0, 0, 0], [0, 0, 2.0]], device=device)
            model = still.moved(escapes, velocity)
            found = errors({"model": model, "truth": true, **baselines.after(step, true)})
            moved = 25_000 * time**2
            assert found["constant_velocity_mm"] == pytest.approx(moved, rel=1e-4)
            fallen = 1000 * 9.81 * time**2 / 2
            assert found["ballistic_mm"] == pytest.approx((moved**2 + fallen**2) ** 0.5, rel=1e-4)
            # Euler goes Δt·v' where the truth goes Δt·(v + v')/2: 10 mm a step further.
            assert found["integrator_floor_mm"] == pytest.approx(floor, abs=1e-3)
            far = (2000**2 + moved**2) ** 0.5
            assert found["position_error_mm"] == pytest.approx((moved + far) / 2, rel=1e-4)
            assert found["escaped"] == 0.5


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_a_particle_that_is_nowhere_has_escaped_and_is_infinitely_wrong(
    make_particles: Make, value: float
) -> None:
    start = make_particles((4, 0))
    broken = start.position.clone()
    broken[0, 0] = value
    model = start.moved(broken, start.velocity)
    found = errors({"model": model, "truth": start, **Baselines(start, Euler()).after(1, start)})
    assert found["position_error_mm"] == torch.inf
    assert found["escaped"] == 0.25
