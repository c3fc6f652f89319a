"""Hard cases of the stress study."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import torch

from fluidsnet.particles import Particles
from fluidsnet.stress.scenes import GRAVITY, Setting, boxed, scaled, with_scene


@final
@dataclass(frozen=True)
class Case:
    """A start state to roll out.

    Attributes:
        name: Name in the tables.
        make: Builds the state.
        steps: Number of steps.
        expected: Whether it resembles what models are trained on, where a model should be stable.
        solver: Whether the solver can run it: fluid in a closed box.
        closed: Whether no force acts from outside, so that momentum stays.
    """

    name: str
    make: Callable[[], Particles]
    steps: int
    expected: bool = False
    solver: bool = False
    closed: bool = False


def cases(setting: Setting, steps: int, rest_steps: int, largest: int) -> list[Case]:
    """Return all cases.

    Args:
        setting: Resolution and time step that the model is for.
        steps: Steps of each case.
        rest_steps: Steps of the pool at rest and of the dam break that comes to rest.
        largest: Particles of the largest case; none where it is 0.
    """
    found = [
        Case("pool at rest", lambda: pool(setting, (12, 8, 12)), rest_steps, True, True),
        Case("dam break", lambda: dam(setting), rest_steps, True, True),
        Case("column, 80 layers deep", lambda: pool(setting, (6, 80, 6)), steps, False, True),
        *_time_steps(setting, steps),
        *_speeds(setting, steps),
        *_values(setting, steps),
        *_few(setting, steps),
        *_bounds(setting, steps),
        *_units(setting, steps),
    ]
    if largest:
        edge = max(2, round((largest / 2) ** (1 / 3)))
        layers = (2 * edge, edge, edge)
        found.append(Case(f"{math.prod(layers):,} particles", lambda: pool(setting, layers), 3))
    return found


def pool(setting: Setting, layers: tuple[int, int, int]) -> Particles:
    """Return fluid at rest that fills a box up to a half."""
    wide, high, deep = layers
    return boxed(setting.block(layers), setting.scene((wide, 2 * high, deep)))


def dam(setting: Setting) -> Particles:
    """Return a column of 1,000 particles in the corner of a box."""
    return boxed(setting.block((10, 10, 10)), setting.scene((26, 18, 10)))


def _time_steps(setting: Setting, steps: int) -> list[Case]:
    def make(factor: float) -> Callable[[], Particles]:
        return lambda: dam(replace(setting, time_step=factor * setting.time_step))

    return [
        Case(f"time step x {factor:g}", make(factor), steps)
        for factor in (0.25, 0.5, 2.0, 4.0, 8.0)
    ]


def _speeds(setting: Setting, steps: int) -> list[Case]:
    def make(speed: float) -> Callable[[], Particles]:
        def thrown() -> Particles:
            place = setting.block((8, 8, 8), (8, 6, 8))
            return boxed(place, setting.scene((24, 20, 24)), (speed, 0.4 * speed, -0.3 * speed))

        return thrown

    return [
        Case(f"thrown at {speed:g} m/s", make(speed), steps, speed <= 1, True)
        for speed in (0.1, 1.0, 10.0, 100.0)
    ]


def _values(setting: Setting, steps: int) -> list[Case]:
    """Return cases of other viscosities and gravities."""

    def viscous(value: float) -> Callable[[], Particles]:
        return lambda: dam(replace(setting, viscosity=value))

    def pulled(x: float, y: float) -> Callable[[], Particles]:
        def make() -> Particles:
            state = dam(setting)
            return with_scene(state, gravity=torch.tensor([[x, y, 0.0]]))

        return make

    g = -GRAVITY[1]
    return [
        *(
            Case(f"viscosity {value:g}", viscous(value), steps, solver=True)
            for value in (0.0, 1.0, 100.0)
        ),
        Case("no gravity", pulled(0.0, 0.0), steps, solver=True),
        Case("gravity sideways", pulled(g, 0.0), steps, solver=True),
        Case("gravity x 10", pulled(0.0, -10 * g), steps, solver=True),
    ]


def _few(setting: Setting, steps: int) -> list[Case]:
    """Return cases of few particles, and of particles at one place."""
    box = setting.scene((12, 12, 12))
    middle = setting.block((1, 1, 1), (5, 5, 5))

    def at(*offsets: float) -> Callable[[], Particles]:
        rows = torch.zeros(len(offsets), 3)
        rows[:, 1] = setting.radius * torch.tensor(offsets)
        return lambda: boxed(middle + rows, box)

    def sheet() -> Particles:
        return boxed(setting.block((12, 1, 12), (0, 4, 0)), box)

    return [
        Case("one particle", at(0.0), steps, solver=True),
        Case("two particles", at(0.0, 2.0), steps, solver=True),
        Case("two at one point", at(0.0, 0.0), steps),
        Case("64 at one point", at(*[0.0] * 64), steps),
        Case("sheet, one particle thick", sheet, steps, solver=True),
        Case("no fluid", at(), steps),
    ]


def _bounds(setting: Setting, steps: int) -> list[Case]:
    """Return cases without walls, and of fluid where it should not be."""
    radius = setting.radius

    def falling() -> Particles:
        scene = setting.scene((10, 200_000, 10))
        height = torch.tensor([0.0, 390_000 * radius, 0.0])
        return boxed(setting.block((5, 5, 5), (2, 0, 2)) + height, scene, walls=False)

    def meeting() -> Particles:
        scene = setting.scene((200, 200, 200), (0.0, 0.0, 0.0))
        left, right = (setting.block((6, 6, 6), (x, 97, y)) for x, y in ((90, 97), (104, 98)))
        state = boxed(torch.cat([left, right]), scene, walls=False)
        speed = state.velocity.clone()
        speed[:216, 0], speed[216:, 0] = 1.0, -1.0
        return state.moved(state.position, speed)

    def shifted(layers: float) -> Callable[[], Particles]:
        def make() -> Particles:
            state = dam(setting)
            push = torch.tensor([-2 * radius * layers, 0.0, 0.0])
            return state.moved(state.position + push, state.velocity)

        return make

    return [
        Case("drop that falls freely", falling, steps),
        Case("two drops collide, no walls", meeting, steps, closed=True),
        Case("fluid inside a wall", shifted(1), steps),
        Case("fluid outside the box", shifted(14), steps),
    ]


def _units(setting: Setting, steps: int) -> list[Case]:
    """Return cases of coordinates far away and of other units."""

    def forgotten() -> Particles:
        return with_scene(scaled(dam(setting), 1e3), gravity=torch.tensor([GRAVITY]))

    return [
        Case("box at 1e4 m", lambda: scaled(dam(setting), 1.0, 1e4), steps),
        Case("lengths in mm", lambda: scaled(dam(setting), 1e3), steps),
        Case("lengths in mm, gravity in m", forgotten, steps),
        Case("box of 1e-6 m", lambda: scaled(dam(setting), 1e-6), steps),
    ]
