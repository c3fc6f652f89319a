"""Closed triangle surfaces: OBJ files, the volume of a surface, and points inside it."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fluidsnet.errors import UserError

#: Offset of rays from the points, in units of the coordinates. Not a multiple of anything, so
#: that a ray does not meet the edges of a surface whose coordinates are round numbers.
_OFFSET = np.array([3.1415926e-7, 2.7182818e-7])


def write_obj(path: Path, vertices: NDArray[np.float64], triangles: ArrayLike) -> None:
    """Write vertices (V, 3) and triangles (T, 3), whose indices count from one."""
    with path.open("w") as file:
        np.savetxt(file, vertices, "v %.9g %.9g %.9g")
        np.savetxt(file, np.asarray(triangles), "f %d %d %d")


def read_obj(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read a closed surface; larger faces are split into triangles.

    Returns:
        Vertices (V, 3), and triangles (T, 3), whose indices count from zero.

    Raises:
        UserError: there is no such file, it cannot be read, or its surface is not closed.
    """
    vertices, triangles = read_faces(path)
    faces: list[tuple[int, int, int]] = [(a, b, c) for a, b, c in triangles.tolist()]
    edges = Counter(frozenset(edge) for a, b, c in faces for edge in ((a, b), (b, c), (c, a)))
    if any(count != 2 for count in edges.values()):
        raise UserError(f"{path}: the surface is open; each edge must belong to two faces.")
    return vertices, triangles


def read_faces(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read a surface, which may be open; larger faces are split into triangles.

    Returns:
        Vertices (V, 3), and triangles (T, 3), whose indices count from zero.

    Raises:
        UserError: there is no such file, or it cannot be read.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; a surface in OBJ format is needed.")
    try:
        for line in path.read_text().splitlines():
            keyword, *values = line.split() or [""]
            if keyword == "v":
                vertices.append([float(value) for value in values[:3]])
            elif keyword == "f":
                corners = [int(value.split("/")[0]) for value in values]
                # A negative index counts from the last vertex.
                corners = [it - 1 if it > 0 else len(vertices) + it for it in corners]
                triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
    except ValueError as error:
        raise UserError(f"{path}: not an OBJ file of text: {error}.") from error
    if not triangles:
        raise UserError(f"{path}: there are no faces in it; a surface in OBJ format is needed.")
    if not 0 <= np.min(triangles) <= np.max(triangles) < len(vertices):
        raise UserError(f"{path}: a face has a vertex that is not in the file; write it again.")
    return np.array(vertices, dtype=np.float64), np.array(triangles, dtype=np.int64)


def enclosed_volume(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> float:
    """Return the volume inside a closed surface, whichever way its faces are turned."""
    first, second, third = (vertices[triangles[:, corner]] for corner in range(3))
    return float(abs(np.sum(first * np.cross(second, third))) / 6)


def enclosed(
    points: NDArray[np.float64], vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which of the points (P, 3) are inside a closed surface, (P,).

    A point is inside if the ray from it along y meets the surface an odd number of times.
    Points in a column share a ray, so a lattice is quick.
    """
    columns, column = np.unique(points[:, [0, 2]], axis=0, return_inverse=True)
    order = np.argsort(column.ravel(), kind="stable")
    members = np.split(order, np.cumsum(np.bincount(column.ravel()))[:-1])
    inside = np.zeros(len(points), dtype=bool)
    corners = vertices[triangles]
    flat, height = corners[:, :, [0, 2]], corners[:, :, 1]
    for place, rows in zip(columns + _OFFSET, members, strict=True):
        sides = flat - place
        following = np.roll(sides, -1, axis=1)
        # Twice the area of the triangle of the ray and each edge; they are barycentric weights
        # of the third corner, all of one sign where the ray meets the triangle.
        areas = sides[..., 0] * following[..., 1] - sides[..., 1] * following[..., 0]
        met = (areas > 0).all(axis=1) | (areas < 0).all(axis=1)
        weights = np.roll(areas[met], -1, axis=1)
        crossing = (weights * height[met]).sum(axis=1) / weights.sum(axis=1)
        above = crossing[:, None] > points[rows, 1]
        inside[rows] = above.sum(axis=0) % 2 == 1
    return inside
