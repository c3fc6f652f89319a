"""Distance of rollouts in other precisions, or from slightly other starts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import fields, replace
from itertools import islice
from typing import Any

import torch

from fluidsnet.model import Model
from fluidsnet.particles import Particles

#: Types of numbers that are compared with float64.
PRECISIONS = {
    "float32": torch.float32,
    "bfloat16": torch.bfloat16,
    "float16": torch.float16,
}
#: Steps after which distances are measured.
AFTER = (1, 10, 25, 50, 100)
#: Standard deviations of the noise on the start, particle radii.
NOISE = (1e-7, 1e-5, 1e-3, 1e-2)

#: Runs a model or the solver: states after 1, 2, … steps of a start and a noise on it (m).
Run = Callable[[float], Iterable[Particles]]


def in_precision(state: Particles, dtype: torch.dtype) -> Particles:
    """Return a state in another type of floating-point numbers."""
    scene = state.scene
    changed: dict[str, Any] = {
        it.name: value.to(dtype)
        for it in fields(scene)
        if isinstance(value := getattr(scene, it.name), torch.Tensor)
    }
    return replace(
        state,
        position=state.position.to(dtype),
        velocity=state.velocity.to(dtype),
        solid_position=state.solid_position.to(dtype),
        solid_velocity=state.solid_velocity.to(dtype),
        scene=replace(scene, **changed),
    )


def precision_rows(model: Model, start: Particles, steps: int) -> list[list[str | float]]:
    """Return distances from a rollout in float64, in radii; a reason where a type cannot be used.

    Args:
        model: Model in evaluation mode.
        start: Start state in float32.
        steps: Number of steps.
    """

    def places(dtype: torch.dtype) -> dict[int, torch.Tensor]:
        copy, state = deepcopy(model).to(dtype), in_precision(start, dtype)
        found = {}
        for step in range(1, steps + 1):
            with torch.no_grad():
                state = copy.step(state)
            if step in AFTER:
                found[step] = state.position.double()
        return found

    truth = places(torch.float64)
    rows: list[list[str | float]] = []
    for name, dtype in PRECISIONS.items():
        try:
            rows.append([name, *_distances(places(dtype), truth, start)])
        except Exception as error:
            # A type that torch cannot compute with; the others go on.
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            rows.append([name, *[f"fails: {reason}"], *[""] * (len(_marks(steps)) - 1)])
    return rows


def growth_rows(run: Run, start: Particles, steps: int) -> list[list[str | float]]:
    """Return distances between rollouts of a start and of the same with noise, in radii.

    Args:
        run: Model or solver.
        start: Start state.
        steps: Number of steps.
    """

    def places(noise: float) -> dict[int, torch.Tensor]:
        states = enumerate(islice(run(noise), steps), start=1)
        return {step: state.position.double() for step, state in states if step in AFTER}

    truth = places(0.0)
    radius = start.scene.particle_radius
    return [[f"{noise:g}", *_distances(places(noise * radius), truth, start)] for noise in NOISE]


def moved(start: Particles, noise: float) -> Particles:
    """Return a start with normal noise on its positions, m."""
    random = torch.Generator().manual_seed(0)
    offset = noise * torch.randn(start.position.shape, generator=random, dtype=torch.float64)
    return start.moved((start.position.double() + offset).float(), start.velocity)


def header(steps: int) -> list[str]:
    """Return the columns of the distances."""
    return [f"{step} steps" for step in _marks(steps)]


def _marks(steps: int) -> list[int]:
    return [step for step in AFTER if step <= steps]


def _distances(
    places: dict[int, torch.Tensor], truth: dict[int, torch.Tensor], start: Particles
) -> list[float]:
    def distance(step: int) -> float:
        if step not in places:
            return torch.inf
        mean = (places[step] - truth[step]).norm(dim=1).mean()
        return float(mean) / start.scene.particle_radius

    return [distance(step) for step in sorted(truth)]
