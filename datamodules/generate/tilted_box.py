"""Random scenes of a pool whose box is tilted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from datamodules.generate.bodies import Range, Vector, vector
from datamodules.generate.scenes import DrawnScene, OneBox
from fluidsnet.errors import UserError


@final
@dataclass
class TiltedBox(OneBox):
    """Pool in a box that is tilted at the start: gravity has another direction and size each time.

    In the axes of the box the fluid starts level and gravity is oblique, so it runs into a corner
    and swashes back.

    Args:
        domain: Edges of the box, m.
        pool: Depth of the pool, as a share of the y edge of the domain.
        tilt: Angle between gravity and the y axis, degrees; its direction is random.
        gravity: Size of gravity, m/s².

    Raises:
        UserError: A range is not possible.
    """

    domain: Vector = (1.5, 1.0, 1.5)
    pool: Range = (0.3, 0.5)
    tilt: Range = (5.0, 30.0)
    gravity: Range = (4.0, 14.0)

    def __post_init__(self) -> None:
        for name, most in (("tilt", 90.0), ("gravity", 1e3)):
            low, high = getattr(self, name)
            if not 0 <= low <= high <= most:
                raise UserError(
                    f"{name} of TiltedBox is [{low}, {high}]; give the least and the greatest "
                    f"value, from 0 to {most:g}."
                )

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        width, height, depth = self.domain
        level = random.uniform(*self.pool) * height
        pool = self.block([0.0, 0.0, 0.0], [width, level, depth], particle_radius)
        tilt, turn = np.radians(random.uniform(*self.tilt)), random.uniform(0.0, 2 * np.pi)
        across = np.sin(tilt) * np.array([np.cos(turn), np.sin(turn)])
        pull = random.uniform(*self.gravity) * np.array([across[0], -np.cos(tilt), across[1]])
        return DrawnScene(self.domain, [pool], gravity=vector(pull))
