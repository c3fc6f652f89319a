"""Random scenes of a dam break in two dimensions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from datamodules.generate.bodies import Block, Range, vector
from datamodules.generate.scenes import CLEARANCE, DamBreak, DrawnScene, SceneKind

#: Layers of the box in which a scene is drawn before it is cut.
_LAYERS = 4


@final
@dataclass
class DamBreak2D(SceneKind):
    """Column of fluid that collapses at one end of a basin, in two dimensions.

    Args:
        domain: Width and height of the basin, m.
        width: Width of the column, as a share of that of the domain.
        height: Height of the column, as a share of that of the domain.
    """

    domain: tuple[float, float] = (4.0, 3.0)
    width: Range = (0.25, 0.5)
    height: Range = (0.5, 0.9)

    def scaled(self, factor: float) -> DamBreak2D:
        return replace(self, domain=(factor * self.domain[0], factor * self.domain[1]))

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        depth = 2 * (_LAYERS + CLEARANCE) * particle_radius
        solid = DamBreak((*self.domain, depth), self.width, self.height)
        (column,) = solid.sample(random, particle_radius).bodies
        lower, upper = column.bounds()
        lower[2], upper[2] = -particle_radius, particle_radius
        flat = Block(vector(lower), vector(upper))
        return DrawnScene((*self.domain, 2 * particle_radius), [flat], dimension=2)
