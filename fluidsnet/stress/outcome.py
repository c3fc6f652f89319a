"""Roll a case out and judge what comes."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, final

import torch
from torch import Tensor

from fluidsnet.errors import UserError
from fluidsnet.metrics.density import Density
from fluidsnet.metrics.energy import kinetic_energy, potential_energy
from fluidsnet.metrics.positions import escaped
from fluidsnet.model import Model
from fluidsnet.particles import Particles

Verdict = Literal["stable", "degrades", "blows up", "fails"]

#: Rise of the energy over its start, and speed over the bound, up to which a case is stable.
#: A jet may be faster than a fall; in these cases the solver's reach 2.9 times the bound.
ENERGY_RISE, SPEED = 0.01, 3.0
#: The same from which it blows up.
BLOWN_RISE, BLOWN_SPEED = 1.0, 6.0
#: Excess density (99.9th percentile) up to which a case is stable.
EXCESS = 0.2

# Rows of the course of a rollout that are kept, and states that are measured, at most.
_ROWS = 500


@final
@dataclass(frozen=True)
class Outcome:
    """Course of a case.

    Attributes:
        steps: Steps asked for.
        survived: Steps with finite states.
        speed: Highest speed over the bound of free fall √(v₀² + 2gh), h the height of the box.
        energy_rise: Highest total energy less that of the start, over the latter and that of a
            fall by a radius.
        escaped: Share of the particles outside the box at the end, less that of the start.
        density: Highest 99.9th percentile of the excess density after the first tenth.
        momentum: Drift of the mean momentum over the mean speed of the start; NaN where forces
            act from outside.
        angular: The same of the mean angular momentum, over speed and distance from the center.
        at_use: What the model says of the scene: "", a warning, or a refusal.
        reason: Why it failed.
        course: Step, kinetic and potential energy, J/kg, and highest speed, m/s.
        last: The last finite state.
    """

    steps: int
    survived: int
    speed: float = math.nan
    energy_rise: float = math.nan
    escaped: float = math.nan
    density: float = math.nan
    momentum: float = math.nan
    angular: float = math.nan
    at_use: str = ""
    reason: str = ""
    course: tuple[tuple[float, float, float, float], ...] = ()
    last: Particles | None = None

    @property
    def verdict(self) -> Verdict:
        """The judgment of the case."""
        if self.reason:
            return "fails"
        if (
            self.survived < self.steps
            or self.energy_rise > BLOWN_RISE
            or self.speed > BLOWN_SPEED
            or self.escaped > 0.5
        ):
            return "blows up"
        if (
            self.energy_rise > ENERGY_RISE
            or self.speed > SPEED
            or self.escaped > 0
            or self.density > EXCESS
        ):
            return "degrades"
        return "stable"


def says_of(model: Model, state: Particles) -> str:
    """Return what a model says when it is used on a scene: "", a warning, or a refusal."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            model.check_time_step(state.scene.time_step)
            model.check_scenes(state.scene)
        except UserError as error:
            return f"refused: {error}"
    return f"warned: {caught[0].message}" if caught else ""


def model_states(
    model: Model, start: Particles, steps: int, advance: Callable[[], None]
) -> Iterable[Particles]:
    """Yield the states after 1, 2, … steps of a model, which may refuse the scene in use."""
    state = start
    for _ in range(steps):
        with torch.no_grad():
            state = model.step(state)
        advance()
        yield state


def judge(
    start: Particles, states: Iterable[Particles], steps: int, closed: bool, at_use: str = ""
) -> Outcome:
    """Measure the course of a case.

    Args:
        start: Start state of one frame.
        states: States after equal times, up to `steps`; it may end early.
        steps: Steps asked for.
        closed: Whether momentum stays.
        at_use: What the model says of the scene.
    """
    if not len(start):
        return _without_fluid(states, steps, at_use)
    density, every = Density(), max(1, steps // _ROWS)
    course, last, survived = [_row(0, start)], start, 0
    fastest, highest, worst = 0.0, -math.inf, 0.0
    try:
        for step, state in enumerate(states, start=1):
            if not bool(state.position.isfinite().all() & state.velocity.isfinite().all()):
                break
            last, survived = state, step
            fastest = max(fastest, float(state.velocity.norm(dim=1).max()))
            if step % every == 0 or step == steps or step < 10:
                course.append(_row(step, state))
                highest = max(highest, course[-1][1] + course[-1][2])
            if step % (10 * every) == 0 and step > steps / 10 and len(start) <= 20_000:
                excess = (density(state) - 1).clamp_min(0)
                worst = max(worst, float(excess.quantile(0.999)))
    except Exception as error:
        # The other cases go on; the reason is a cell of the table.
        return Outcome(steps, survived, at_use=at_use, reason=f"{type(error).__name__}: {error}")
    momentum, angular = _drifts(start, last) if closed else (math.nan, math.nan)
    before = course[0][1] + course[0][2]
    pull = float(start.scene.gravity.double().norm())
    scale = abs(before) + max(pull * start.scene.particle_radius, 1e-30)
    return Outcome(
        steps=steps,
        survived=survived,
        speed=fastest / _bound(start),
        energy_rise=(highest - before) / scale if survived else math.nan,
        escaped=float(escaped(last) - escaped(start)),
        density=worst,
        momentum=momentum,
        angular=angular,
        at_use=at_use,
        course=tuple(course),
        last=last,
    )


def _without_fluid(states: Iterable[Particles], steps: int, at_use: str) -> Outcome:
    """Return the outcome of a scene without fluid: that each step can be taken."""
    try:
        survived = sum(len(state) == 0 for state in states)
    except Exception as error:
        return Outcome(steps, 0, at_use=at_use, reason=f"{type(error).__name__}: {error}")
    return Outcome(steps, survived, 0.0, 0.0, 0.0, 0.0, at_use=at_use)


def _row(step: int, state: Particles) -> tuple[float, float, float, float]:
    speed = state.velocity.norm(dim=1).max()
    return step, float(kinetic_energy(state)), float(potential_energy(state)), float(speed)


def _bound(start: Particles) -> float:
    """Return the highest speed that a fall through the box allows, m/s.

    Without gravity and speed it is a radius in a step.
    """
    scene = start.scene
    fall = float((scene.gravity.double().abs() * scene.extent).sum())
    swiftest = float(start.velocity.double().square().sum(dim=1).max())
    least = scene.particle_radius / scene.time_step
    bound = math.sqrt(swiftest + 2 * fall)
    return bound if bound > 0 else least


def _drifts(start: Particles, end: Particles) -> tuple[float, float]:
    """Return the drifts of momentum and angular momentum, relative to those of the parts."""
    center = start.position.double().mean(dim=0)
    speed = start.velocity.double().norm(dim=1).mean().clamp_min(1e-30)
    arm = (start.position.double() - center).norm(dim=1).mean().clamp_min(1e-30)

    def turning(state: Particles) -> Tensor:
        arms = state.position.double() - center
        turned: Tensor = torch.linalg.cross(arms, state.velocity.double()).mean(dim=0)
        return turned

    change = end.velocity.double().mean(dim=0) - start.velocity.double().mean(dim=0)
    turned = turning(end) - turning(start)
    return float(change.norm() / speed), float(turned.norm() / (speed * arm))
