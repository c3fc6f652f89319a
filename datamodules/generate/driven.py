"""Random scenes with a solid that moves: a stirred tank, and a tank with a wave maker."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from datamodules.generate.bodies import Range, Vector
from datamodules.generate.moving_solids import MovingSolid
from datamodules.generate.scenes import CLEARANCE, DrawnScene, OneBox
from fluidsnet.errors import UserError

#: Thickness of a plate, particle radii: both of its faces are sampled, apart from each other.
_THICKNESS = 4.0


@final
@dataclass
class StirredTank(OneBox):
    """Pool with a paddle that turns around the vertical axis through its center.

    Args:
        domain: Edges of the box, m.
        pool: Depth of the pool, as a share of the y edge of the domain.
        paddle: Width of the paddle, as a share of the shorter horizontal edge of the domain.
        speed: Angular speed, rad/s, either way around.

    Raises:
        UserError: The paddle would touch the walls, or does not turn.
    """

    domain: Vector = (1.5, 1.0, 1.5)
    pool: Range = (0.35, 0.5)
    paddle: Range = (0.4, 0.6)
    speed: Range = (2.0, 4.0)

    def __post_init__(self) -> None:
        _check("paddle of StirredTank", self.paddle, most=0.8)
        _check("speed of StirredTank", self.speed)

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        width, height, depth = self.domain
        level = random.uniform(*self.pool) * height
        pool = self.block([0.0, 0.0, 0.0], [width, level, depth], particle_radius)
        gap = 2 * CLEARANCE * particle_radius
        top = max(0.8 * level, gap + _THICKNESS * particle_radius)
        edges = (
            random.uniform(*self.paddle) * min(width, depth),
            top - gap,
            _THICKNESS * particle_radius,
        )
        center = (width / 2, (gap + top) / 2, depth / 2)
        speed = random.uniform(*self.speed) * random.choice([-1, 1])
        paddle = MovingSolid(edges, center, spin=(0.0, float(speed), 0.0))
        return DrawnScene(self.domain, [pool], solids=[paddle])


@final
@dataclass
class WaveMaker(OneBox):
    """Channel of fluid with a plate at one end that swings to and fro.

    Args:
        domain: Edges of the box, m.
        pool: Depth of the fluid, as a share of the y edge of the domain.
        stroke: Way of the plate, as a share of the x edge of the domain.
        period: Time of a stroke to and fro, s.

    Raises:
        UserError: The stroke is too long, or the plate does not move.
    """

    domain: Vector = (3.0, 1.0, 0.75)
    pool: Range = (0.3, 0.45)
    stroke: Range = (0.05, 0.1)
    period: Range = (0.8, 1.4)

    def __post_init__(self) -> None:
        _check("stroke of WaveMaker", self.stroke, most=0.5)
        _check("period of WaveMaker", self.period)

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        width, height, depth = self.domain
        thickness = _THICKNESS * particle_radius
        start = 2 * thickness
        level = random.uniform(*self.pool) * height
        pool = self.block([start, 0.0, 0.0], [width - start, level, depth], particle_radius)
        swing = random.uniform(*self.stroke) * width / 2
        plate = MovingSolid(
            edges=(thickness, height, depth),
            center=(start - thickness / 2, height / 2, depth / 2),
            swing=(float(swing), 0.0, 0.0),
            frequency=float(2 * np.pi / random.uniform(*self.period)),
        )
        return DrawnScene(self.domain, [pool], solids=[plate])


def _check(what: str, extent: Range, most: float = math.inf) -> None:
    """Check the least and the greatest value of a range.

    Raises:
        UserError: They are not above zero, in order, and at most `most`.
    """
    if not 0 < extent[0] <= extent[1] <= most:
        limit = f" and at most {most:g}" if most < math.inf else ""
        raise UserError(
            f"{what} is {list(extent)}; give the least and the greatest value, above 0{limit}."
        )
