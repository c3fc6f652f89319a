"""Solids that move in a scene: cuboids with a prescribed motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from datamodules.generate.bodies import Vector
from datamodules.generate.obj import write_obj
from datamodules.generate.shapes import Points

_STILL = (0.0, 0.0, 0.0)


@final
@dataclass(frozen=True)
class MovingSolid:
    """Cuboid that swings along a line and turns around its center.

    Its velocity at time t is ω·A·sin(ωt), so that it starts at rest and its center stays between
    the start and the start + 2A.

    Attributes:
        edges: Edges along x, y and z at the start, m.
        center: Center at the start, m.
        swing: Amplitude A, m.
        frequency: ω of the swing, rad/s.
        spin: Angular velocity, which is constant, rad/s.
    """

    edges: Vector
    center: Vector
    swing: Vector = _STILL
    frequency: float = 0.0
    spin: Vector = _STILL

    def velocity(self, time: float) -> list[float]:
        """Return the velocity of the center, m/s, at a time, s."""
        return [self.frequency * it * math.sin(self.frequency * time) for it in self.swing]

    def shift(self, time: float) -> Points:
        """Return the way of the center, (3,) m, from the start to a time, s."""
        way: Points = np.array(self.swing) * (1 - math.cos(self.frequency * time))
        return way

    def distance(self, points: Points) -> Points:
        """Return the distance (P,) of points (P, 3) from the cuboid at the start, m."""
        beyond = np.abs(points - np.array(self.center)) - np.array(self.edges) / 2
        distance: Points = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return distance

    def write(self, path: Path) -> None:
        """Write the surface, around the origin, as an OBJ file."""
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        write_obj(path, corners * np.array(self.edges) / 2, BOX)


#: Triangles of a box whose corners are in the order of x, y and z, counted from one.
BOX = [
    (a, b, c)
    for w, x, y, z in (
        (1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)
    )
    for a, b, c in ((w, x, y), (w, y, z))
]  # fmt: skip


def describe_solids(solids: Sequence[MovingSolid]) -> list[dict[str, Any]]:
    """Return solids as JSON values."""
    return [*map(asdict, solids)]


def solids_from(values: Sequence[dict[str, Any]]) -> list[MovingSolid]:
    """Return the solids that `describe_solids` described, also after a way through JSON."""
    plain: list[dict[str, Any]] = [
        {name: tuple(it) if isinstance(it, list) else it for name, it in solid.items()}
        for solid in values
    ]
    return [MovingSolid(**solid) for solid in plain]
