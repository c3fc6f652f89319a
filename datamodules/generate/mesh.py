"""Closed triangle meshes written for the solver: the walls, a ball, or a mesh of the user."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.bodies import Drop, Vector
from datamodules.generate.moving_solids import BOX
from datamodules.generate.obj import read_obj, write_obj


def write_box(path: Path, lower: Vector, upper: Vector) -> None:
    """Write a closed box, given two corners of it."""
    write_obj(path, np.array(list(product(*zip(lower, upper, strict=True)))), BOX)


def write_drop(path: Path, drop: Drop, particle_radius: float) -> None:
    """Write the surface of a drop around the origin: a ball, or its mesh scaled to fit one."""
    vertices, triangles = drop_surface(drop)
    if drop.radius < particle_radius:
        raise RuntimeError(f"the drop's radius {drop.radius} m is below the particle radius")
    write_obj(path, vertices, triangles + 1)


def drop_surface(drop: Drop) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (V, 3) around the origin and triangles (T, 3) of a drop, from zero."""
    if drop.mesh is None:
        vertices, corners = _ball(drop.radius)
        return vertices, np.array(corners) - 1
    vertices, triangles = read_obj(Path(drop.mesh))
    vertices -= (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    vertices *= drop.radius / np.linalg.norm(vertices, axis=1).max()
    return vertices, triangles


def _ball(radius: float) -> tuple[NDArray[np.float64], list[tuple[int, int, int]]]:
    """Return vertices and triangles of a sphere with 24 x 48 faces by latitude and longitude."""
    rows, columns = 24, 48
    polar = np.linspace(0, np.pi, rows + 1)[1:-1, None]
    azimuth = np.arange(columns) * 2 * np.pi / columns
    x, z = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth)
    rings = np.stack([x, np.broadcast_to(np.cos(polar), x.shape), z], axis=-1).reshape(-1, 3)
    vertices = radius * np.concatenate([[[0.0, 1.0, 0.0]], rings, [[0.0, -1.0, 0.0]]])
    # Vertices count from one, and the first is the pole.
    here = 2 + np.arange(len(rings)).reshape(rows - 1, columns)
    following = np.roll(here, -1, axis=1)
    top, bottom = np.full(columns, 1), np.full(columns, len(vertices))
    triangles = [
        (top, following[0], here[0]),
        (here[:-1], following[:-1], here[1:]),
        (following[:-1], following[1:], here[1:]),
        (bottom, here[-1], following[-1]),
    ]
    corners = np.concatenate([np.stack(sides, axis=-1).reshape(-1, 3) for sides in triangles])
    return vertices, [(a, b, c) for a, b, c in corners.tolist()]
