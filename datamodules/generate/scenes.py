"""Random scenes: `SceneKind`, and the paper's three kinds (section 5.1, figure 5).

A scene kind draws the bodies of fluid, and the box if it varies, with a random generator. Sizes
of the paper's kinds are shares of the domain, so they work for a domain of any size. The up axis
is y.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datamodules.generate.bodies import Block, Body, Drop, Range, vector
from datamodules.generate.bodies import Vector as Vector  # re-exported
from datamodules.generate.moving_solids import MovingSolid
from fluidsnet.errors import UserError

#: Particle radii between a wall and the surface of the fluid at the start. With the boundary
#: particles of Akinci et al. 2012, fluid at one radius is 6 % too dense at a wall and 12 %
#: in a corner, and bursts apart in the first step; from 1.2 on it is at rest density.
CLEARANCE = 1.25

#: Fewest layers of particles in a block: SPlisHSPlasH silently drops a block of one layer.
FEWEST_LAYERS = 2


@final
@dataclass(frozen=True)
class DrawnScene:
    """Box and fluid of one simulation.

    Attributes:
        domain: Edges of the box of fluid and air, m; its lower corner is the origin.
        bodies: Fluid at the start.
        viscosity: Coefficient of the solver; None for that of the recipe.
        solids: Solids that move.
        gravity: m/s²; None for that of the recipe.
        dimension: 3; or 2, where the fluid lies in the plane z = 0.
    """

    domain: Vector
    bodies: list[Body]
    viscosity: float | None = None
    solids: list[MovingSolid] = field(default_factory=list)
    gravity: Vector | None = None
    dimension: int = 3


class SceneKind(ABC):
    """Distribution of random scenes."""

    @abstractmethod
    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        """Draw one scene.

        The bodies lie inside the walls with a clearance of `CLEARANCE` particle radii and do not
        overlap.
        """

    @abstractmethod
    def scaled(self, factor: float) -> SceneKind:
        """Return this distribution with all lengths larger by a factor."""


class OneBox(SceneKind):
    """Distribution of random scenes in one box; blocks are a whole number of particles wide.

    Attributes:
        domain: Edges of the box of fluid and air, m; its lower corner is the origin.
    """

    domain: Vector

    def scaled(self, factor: float) -> SceneKind:
        other = copy.copy(self)
        other.domain = vector(factor * np.array(self.domain))
        return other

    def room(self, particle_radius: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lower and upper corner, in m, of the box in which fluid may start."""
        clearance = CLEARANCE * particle_radius
        return np.full(3, clearance), np.array(self.domain, dtype=np.float64) - clearance

    def block(self, corner: ArrayLike, edges: ArrayLike, particle_radius: float) -> Block:
        """Return a block of whole particles, with rounded edges and moved inside the walls.

        Raises:
            UserError: the domain is too small for such particles.
        """
        lower_limit, upper_limit = self.room(particle_radius)
        spacing = 2 * particle_radius
        # The tolerance keeps 0.3 / 0.1 from losing a layer to rounding.
        most = np.floor((upper_limit - lower_limit) / spacing + 1e-6)
        if (most < FEWEST_LAYERS).any():
            raise UserError(
                f"particle_radius is {particle_radius}; particles that large do not fit into a "
                f"domain of {self.domain} m."
            )
        layers = np.clip(np.round(np.array(edges) / spacing), FEWEST_LAYERS, most)
        lower = np.clip(np.array(corner), lower_limit, upper_limit - layers * spacing)
        upper = lower + layers * spacing
        return Block(vector(lower), vector(upper))


@final
@dataclass
class DamBreak(OneBox):
    """Column of fluid that collapses in a corner of a basin (figures 5b and 8).

    Args:
        domain: Edges of the box, in m.
        width: Width of the column, as a share of the x edge of the domain.
        height: Height of the column, as a share of the y edge of the domain.
        depth: Depth of the column, as a share of the z edge of the domain.
    """

    domain: Vector = (6.0, 4.0, 6.0)
    width: Range = (0.35, 0.55)
    height: Range = (0.66, 0.90)
    depth: Range = (0.84, 1.0)

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        shares = [random.uniform(*extent) for extent in (self.width, self.height, self.depth)]
        edges = np.multiply(shares, self.domain)
        side = random.integers(0, 2, size=2)
        corner = [side[0] * self.domain[0], 0.0, side[1] * self.domain[2]]
        return DrawnScene(self.domain, [self.block(corner, edges, particle_radius)])


@final
@dataclass
class CuboidBasin(OneBox):
    """Cuboid of fluid that falls into an empty basin (figures 5a and 7).

    Args:
        domain: Edges of the box, in m.
        edge: Each edge of the cuboid, as a share of the shortest edge of the domain.
        lift: Height of the cuboid's lower face, as a share of the y edge of the domain.
    """

    domain: Vector = (7.0, 7.0, 7.0)
    edge: Range = (0.36, 0.51)
    lift: Range = (0.25, 0.45)

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        edges = random.uniform(*self.edge, size=3) * min(self.domain)
        corner = random.uniform(size=3) * np.maximum(np.array(self.domain) - edges, 0.0)
        corner[1] = random.uniform(*self.lift) * self.domain[1]
        return DrawnScene(self.domain, [self.block(corner, edges, particle_radius)])


@final
@dataclass
class DropPool(OneBox):
    """Drop that falls into a pool of resting fluid (figures 5c and 9).

    Args:
        domain: Edges of the box, in m.
        pool: Depth of the pool, as a share of the y edge of the domain.
        radius: Radius of the drop, as a share of the shortest edge of the domain.
        fall: Height of the drop above the pool, as a share of the y edge of the domain.
        mesh: OBJ file with a closed surface to use in place of a ball.
    """

    domain: Vector = (7.0, 7.0, 7.0)
    pool: Range = (0.15, 0.20)
    radius: Range = (0.15, 0.21)
    fall: Range = (0.05, 0.35)
    mesh: Path | None = None

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        depth = random.uniform(*self.pool) * self.domain[1]
        pool = self.block([0.0, 0.0, 0.0], [self.domain[0], depth, self.domain[2]], particle_radius)
        lower, upper = self.room(particle_radius)
        # At least one spacing of air between pool and drop, so that they never overlap.
        floor = pool.upper[1] + 2 * particle_radius
        widest = min(float(np.min(upper - lower)), float(upper[1] - floor)) / 2
        radius = min(random.uniform(*self.radius) * min(self.domain), widest)
        center = random.uniform(lower + radius, upper - radius)
        height = floor + random.uniform(*self.fall) * self.domain[1] + radius
        center[1] = min(height, float(upper[1]) - radius)
        mesh = None if self.mesh is None else str(self.mesh.resolve())
        return DrawnScene(self.domain, [pool, Drop(vector(center), radius, mesh)])
