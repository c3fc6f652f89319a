"""Bodies of fluid at the start of a simulation, and their description as JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.shapes import Ball, Cuboid, Mesh, Points, Shape, Torus

Vector = tuple[float, float, float]
Range = tuple[float, float]
Quaternion = tuple[float, float, float, float]


@final
@dataclass(frozen=True)
class Block:
    """Cuboid of fluid, up to the surfaces of its particles, in m."""

    lower: Vector
    upper: Vector

    def bounds(self) -> tuple[Points, Points]:
        """Return the lower and upper corner of the bounding box, in m."""
        return np.array(self.lower), np.array(self.upper)


@final
@dataclass(frozen=True)
class Drop:
    """Ball of fluid, or a closed mesh scaled to fit into one."""

    center: Vector  # of the ball, m
    radius: float  # of the ball, m
    mesh: str | None = None  # Wavefront OBJ file with a closed surface

    def bounds(self) -> tuple[Points, Points]:
        """Return the lower and upper corner of the bounding box, in m."""
        return np.array(self.center) - self.radius, np.array(self.center) + self.radius


@final
@dataclass(frozen=True)
class MovingBody:
    """Body of fluid of any shape, turned and placed, that starts with a velocity."""

    shape: Shape
    center: Vector  # place of the shape's origin, m
    rotation: Quaternion  # unit quaternion w, x, y, z
    velocity: Vector  # of all particles, m/s

    def bounds(self) -> tuple[Points, Points]:
        """Return the lower and upper corner of the bounding box of the surface, in m."""
        surface = turned(self.shape.surface(), self.rotation) + np.array(self.center)
        return surface.min(axis=0), surface.max(axis=0)

    def particles(self, particle_radius: float) -> Points:
        """Return the positions (P, 3) of the particles, m."""
        particles = turned(self.shape.particles(particle_radius), self.rotation)
        particles += np.array(self.center)
        return particles


Body = Block | Drop | MovingBody

_SHAPES: dict[str, type[Shape]] = {
    kind.__name__.lower(): kind for kind in (Cuboid, Ball, Torus, Mesh)
}
_PLACEMENT = ("center", "rotation", "velocity")
_BODIES: dict[str, type[Block] | type[Drop]] = {"block": Block, "drop": Drop}


def turned(points: Points, rotation: Quaternion) -> Points:
    """Return points (P, 3) turned around the origin by a unit quaternion."""
    real, axis = rotation[0], np.array(rotation[1:])
    across = np.cross(axis, points)
    result: Points = points + 2 * (real * across + np.cross(axis, across))
    return result


def describe(body: Body) -> dict[str, Any]:
    """Return a body as JSON values."""
    if isinstance(body, MovingBody):
        placed = {name: getattr(body, name) for name in _PLACEMENT}
        return {"shape": type(body.shape).__name__.lower(), **vars(body.shape), **placed}
    return {"shape": type(body).__name__.lower(), **asdict(body)}


def from_description(values: dict[str, Any]) -> Body:
    """Return the body that `describe` described, also after a way through JSON."""
    plain: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
    }
    shape: str = plain.pop("shape")
    if shape in _BODIES:
        return _BODIES[shape](**plain)
    placed = {name: plain.pop(name) for name in _PLACEMENT}
    return MovingBody(_SHAPES[shape](**plain), **placed)


def shape_and_mesh(body: Body) -> tuple[str, str | None]:
    """Return the name of a body's shape, and the OBJ file of a mesh."""
    described = describe(body)
    return described["shape"], described.get("mesh", described.get("path"))


def vector(values: NDArray[np.float64]) -> Vector:
    """Return three numbers rounded to nine decimals, which JSON keeps."""
    x, y, z = (round(float(value), 9) for value in values)
    return x, y, z
