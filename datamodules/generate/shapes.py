"""Closed shapes of fluid bodies around the origin, and their particles on a cubic lattice."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Self, final

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.obj import enclosed, enclosed_volume, read_obj

Points = NDArray[np.float64]


def _sphere(count: int) -> Points:
    """Return points (count, 3) on the unit sphere, a Fibonacci lattice: equal areas, no poles."""
    height = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=1)


_SPHERE = _sphere(2000)


class Shape(ABC):
    """Closed shape around the origin; lengths are in m."""

    @abstractmethod
    def volume(self) -> float:
        """Return the volume, m³."""

    @abstractmethod
    def scaled(self, factor: float) -> Self:
        """Return the shape with all lengths multiplied by a factor."""

    @abstractmethod
    def surface(self) -> Points:
        """Return surface points (V, 3) that give the bounding box in any rotation."""

    @abstractmethod
    def contains(self, points: Points) -> NDArray[np.bool_]:
        """Return which of the points (P, 3) are inside, (P,)."""

    def particles(self, particle_radius: float) -> Points:
        """Return the particles (P, 3) inside, one spacing apart, which is at rest density."""
        surface, spacing = self.surface(), 2 * particle_radius
        lower, upper = surface.min(axis=0), surface.max(axis=0)
        # The tolerance keeps 0.3 / 0.1 from losing a layer to rounding.
        layers = np.floor((upper - lower) / spacing + 1e-6)
        first = (lower + upper - (layers - 1) * spacing) / 2
        axes = [start + spacing * np.arange(n) for start, n in zip(first, layers, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        inside: Points = grid[self.contains(grid)]
        return inside


@final
@dataclass(frozen=True)
class Cuboid(Shape):
    """Cuboid with the given edges."""

    edges: tuple[float, float, float]

    def volume(self) -> float:
        return float(np.prod(self.edges))

    def scaled(self, factor: float) -> Cuboid:
        x, y, z = self.edges
        return Cuboid((factor * x, factor * y, factor * z))

    def surface(self) -> Points:
        signs = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        corners: Points = signs * np.array(self.edges)
        return corners

    def contains(self, points: Points) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = np.all(np.abs(points) <= np.array(self.edges) / 2, axis=1)
        return inside


@final
@dataclass(frozen=True)
class Torus(Shape):
    """Ring around the y axis.

    Attributes:
        ring: Radius of the circle in the middle of the tube, m.
        tube: Radius of the tube, m; below that of the ring.
    """

    ring: float
    tube: float

    def volume(self) -> float:
        return 2 * np.pi**2 * self.ring * self.tube**2

    def scaled(self, factor: float) -> Torus:
        return Torus(factor * self.ring, factor * self.tube)

    def surface(self) -> Points:
        around, across = np.meshgrid(*[np.linspace(0, 2 * np.pi, n) for n in (97, 49)])
        distance = self.ring + self.tube * np.cos(across)
        height = self.tube * np.sin(across)
        points = [distance * np.cos(around), height, distance * np.sin(around)]
        return np.stack(points, axis=-1).reshape(-1, 3)

    def contains(self, points: Points) -> NDArray[np.bool_]:
        from_ring = np.hypot(points[:, 0], points[:, 2]) - self.ring
        inside: NDArray[np.bool_] = np.hypot(from_ring, points[:, 1]) <= self.tube
        return inside


@final
@dataclass(frozen=True)
class Ball(Shape):
    """Ball whose radius varies with the direction; without harmonics an exact ball.

    Attributes:
        radius: m.
        harmonics: Coefficients of the spherical harmonics of order 2, then 3, in `_harmonics`:
            the radius in a direction is `radius` times (1 + their sum), which stays positive.
    """

    radius: float
    harmonics: tuple[float, ...] = ()

    def volume(self) -> float:
        return float(4 / 3 * np.pi * np.mean(self._reach(_SPHERE) ** 3))

    def scaled(self, factor: float) -> Ball:
        return replace(self, radius=factor * self.radius)

    def surface(self) -> Points:
        return _SPHERE * self._reach(_SPHERE)[:, None]

    def contains(self, points: Points) -> NDArray[np.bool_]:
        distance = np.linalg.norm(points, axis=1)
        directions = points / np.maximum(distance, 1e-12)[:, None]
        inside: NDArray[np.bool_] = distance <= self._reach(directions)
        return inside

    def flattest(self) -> float:
        """Return the least radius over all directions, as a share of `radius`."""
        return float(self._reach(_SPHERE).min() / self.radius)

    def _reach(self, directions: Points) -> Points:
        """Return the radius in each unit direction (P, 3), (P,)."""
        functions = _harmonics(directions)[: len(self.harmonics)]
        return self.radius * (1 + np.tensordot(self.harmonics, functions, axes=1))


#: Number of spherical harmonics of orders 2 and 3.
HARMONICS = 12


def _harmonics(directions: Points) -> Points:
    """Return the real spherical harmonics of orders 2 and 3, not normalized, (12, P)."""
    x, y, z = directions.T
    second = [x * y, y * z, z * x, x**2 - y**2, 3 * z**2 - 1]
    third = [
        x * y * z,
        z * (x**2 - y**2),
        x * (5 * z**2 - 1),
        y * (5 * z**2 - 1),
        z * (5 * z**2 - 3),
        x * (x**2 - 3 * y**2),
        y * (3 * x**2 - y**2),
    ]
    return np.stack(second + third)


@final
@dataclass(frozen=True)
class Mesh(Shape):
    """Closed surface of an OBJ file.

    Attributes:
        path: The file.
        size: Longest edge of the bounding box, m, to which the surface is scaled.
    """

    path: str
    size: float

    def volume(self) -> float:
        vertices, triangles = _unit_mesh(self.path)
        return enclosed_volume(vertices, triangles) * self.size**3

    def scaled(self, factor: float) -> Mesh:
        return replace(self, size=factor * self.size)

    def surface(self) -> Points:
        return _unit_mesh(self.path)[0] * self.size

    def contains(self, points: Points) -> NDArray[np.bool_]:
        return enclosed(points / self.size, *_unit_mesh(self.path))


@lru_cache(maxsize=64)
def _unit_mesh(path: str) -> tuple[Points, NDArray[np.int64]]:
    """Return vertices (V, 3), with a bounding box of longest edge 1, and triangles (T, 3)."""
    vertices, triangles = read_obj(Path(path))
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    return (vertices - (lower + upper) / 2) / (upper - lower).max(), triangles
