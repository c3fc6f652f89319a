"""Closed triangle meshes for the solver: the walls, a ball, or a mesh of the user."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.scenes import Drop, Vector


def write_box(path: Path, domain: Vector) -> None:
    """Write a closed box from the origin to the upper corner of the domain."""
    width, height, depth = domain
    corners = [(x, y, z) for x in (0.0, width) for y in (0.0, height) for z in (0.0, depth)]
    faces = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    triangles = [(a, b, c) for a, b, c, _ in faces] + [(a, c, d) for a, _, c, d in faces]
    _write_obj(path, np.array(corners), triangles)


def write_drop(path: Path, drop: Drop, particle_radius: float) -> None:
    """Write the surface of a drop around the origin: a ball, or its mesh scaled to fit one."""
    if drop.mesh is None:
        vertices, triangles = _ball(drop.radius)
    else:
        vertices, triangles = _read_obj(Path(drop.mesh))
        vertices -= (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        vertices *= drop.radius / np.linalg.norm(vertices, axis=1).max()
    if drop.radius < particle_radius:
        raise RuntimeError(f"the drop's radius {drop.radius} m is below the particle radius")
    _write_obj(path, vertices, triangles)


def _ball(radius: float) -> tuple[NDArray[np.float64], list[tuple[int, int, int]]]:
    """Return vertices and triangles of a sphere with 24 x 48 faces by latitude and longitude."""
    rows, columns = 24, 48
    polar = np.linspace(0, np.pi, rows + 1)[1:-1]
    azimuth = np.arange(columns) * 2 * np.pi / columns
    ring = np.stack(
        [
            np.outer(np.sin(polar), np.cos(azimuth)),
            np.outer(np.cos(polar), np.ones(columns)),
            np.outer(np.sin(polar), np.sin(azimuth)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    vertices = radius * np.concatenate([[[0.0, 1.0, 0.0]], ring, [[0.0, -1.0, 0.0]]])
    last = len(vertices)
    triangles: list[tuple[int, int, int]] = []
    for column in range(columns):
        following = (column + 1) % columns
        triangles.append((1, 2 + following, 2 + column))
        for row in range(rows - 2):
            upper, lower = 2 + row * columns, 2 + (row + 1) * columns
            triangles.append((upper + column, upper + following, lower + column))
            triangles.append((upper + following, lower + following, lower + column))
        bottom = 2 + (rows - 2) * columns
        triangles.append((last, bottom + column, bottom + following))
    return vertices, triangles


def _write_obj(
    path: Path, vertices: NDArray[np.float64], triangles: list[tuple[int, int, int]]
) -> None:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in triangles]
    path.write_text("\n".join(lines) + "\n")


def _read_obj(path: Path) -> tuple[NDArray[np.float64], list[tuple[int, int, int]]]:
    """Read vertices and triangles of an OBJ file; larger faces are split into triangles."""
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    if not path.is_file():
        raise RuntimeError(f"{path}: there is no such file; a closed OBJ surface is needed")
    for line in path.read_text().splitlines():
        keyword, *values = line.split() or [""]
        if keyword == "v":
            vertices.append([float(value) for value in values[:3]])
        elif keyword == "f":
            corners = [int(value.split("/")[0]) for value in values]
            corners = [corner if corner > 0 else len(vertices) + 1 + corner for corner in corners]
            triangles += [(corners[0], second, third) for second, third in pairwise(corners[1:])]
    if not triangles:
        raise RuntimeError(f"{path}: there are no faces in it; a closed OBJ surface is needed")
    edges = Counter(frozenset(edge) for a, b, c in triangles for edge in ((a, b), (b, c), (c, a)))
    if any(count != 2 for count in edges.values()):
        raise RuntimeError(f"{path}: the surface is open; each edge must belong to two faces")
    return np.array(vertices), triangles
