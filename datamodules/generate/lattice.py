"""Particles of fluid bodies, walls and surfaces on lattices, made without the solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.bodies import Block, Body, Drop
from datamodules.generate.mesh import drop_surface
from datamodules.generate.moving_solids import MovingSolid
from datamodules.generate.obj import enclosed
from datamodules.generate.scenes import CLEARANCE
from datamodules.generate.shapes import Points

#: Particles of a surface nearer to each other than this share of a spacing are one.
_SAME = 0.25


def block_lattice(block: Block, particle_radius: float) -> Points:
    """Return the particles (P, 3) of a block, m, one spacing apart."""
    lower, upper = block.bounds()
    first = lower + particle_radius
    # The tolerance keeps 0.3 / 0.1 from losing a layer to rounding.
    layers = np.floor((upper - lower) / (2 * particle_radius) + 1e-6).astype(int)
    axes = (np.arange(count) for count in layers)
    return first + 2 * particle_radius * grid(*axes)


def enclosed_lattice(
    vertices: Points, triangles: NDArray[np.int64], particle_radius: float
) -> Points:
    """Return the particles (P, 3) inside a closed surface, m, one spacing apart.

    Args:
        vertices: (V, 3) m.
        triangles: (T, 3) indices of vertices.
        particle_radius: m.
    """
    lower, upper, spacing = vertices.min(axis=0), vertices.max(axis=0), 2 * particle_radius
    layers = np.floor((upper - lower) / spacing + 1e-6)
    first = (lower + upper - (layers - 1) * spacing) / 2
    points = grid(*(a + spacing * np.arange(n) for a, n in zip(first, layers, strict=True)))
    return points[enclosed(points, vertices, triangles)]


def body_lattice(body: Body, particle_radius: float) -> Points:
    """Return the particles (P, 3) of a body, m."""
    if isinstance(body, Block):
        return block_lattice(body, particle_radius)
    if isinstance(body, Drop):
        vertices, triangles = drop_surface(body)
        return enclosed_lattice(vertices + np.array(body.center), triangles, particle_radius)
    return body.particles(particle_radius)


def clear_of(solids: Sequence[MovingSolid], points: Points, particle_radius: float) -> Points:
    """Return the points (P, 3) that are not in solids or too close to them."""
    for solid in solids:
        points = points[solid.distance(points) > (1 + CLEARANCE) * particle_radius]
    return points


def box_lattice(lower: Points, upper: Points, particle_radius: float, flat: bool = False) -> Points:
    """Return particles (M, 3) on the sides of a box, at most a spacing apart, m.

    Args:
        lower: (3,) corner, m.
        upper: (3,) corner, m.
        particle_radius: m.
        flat: In two dimensions: on the outline of the box, in the middle of its depth.
    """
    counts = np.maximum(np.ceil((upper - lower) / (2 * particle_radius) - 1e-6), 1).astype(int)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(lower, upper, counts, strict=True)]
    if flat:
        axes[2] = np.array([(lower[2] + upper[2]) / 2])
    sides = []
    for axis in range(2 if flat else 3):
        # An edge belongs to the side of the first of its axes.
        across = [it[1:-1] if other < axis else it for other, it in enumerate(axes)]
        across[axis] = axes[axis][[0, -1]]
        sides.append(grid(*across))
    return np.concatenate(sides)


def surface_lattice(
    vertices: Points, triangles: NDArray[np.int64], particle_radius: float
) -> Points:
    """Return particles (M, 3) on a surface of triangles, at most a spacing apart, m.

    Args:
        vertices: (V, 3) m.
        triangles: (T, 3) indices of vertices; the surface may be open.
        particle_radius: m.
    """
    spacing, found = 2 * particle_radius, []
    for corners in vertices[triangles]:
        edges = np.roll(corners, -1, axis=0) - corners
        # The corner between the two shorter edges, so that a rectangle has a rectangular lattice.
        start = (int(np.argmax((edges**2).sum(axis=1))) + 2) % 3
        one, two = corners[(start + 1) % 3] - corners[start], corners[start - 1] - corners[start]
        counts = [max(int(np.ceil(np.linalg.norm(it) / spacing - 1e-6)), 1) for it in (one, two)]
        along, across = (np.arange(n + 1) / n for n in counts)
        shares = grid(along, across)
        shares = shares[shares.sum(axis=1) <= 1 + 1e-9]
        found.append(corners[start] + shares @ np.stack([one, two]))
    points = np.concatenate(found)
    cells = np.round(points / (_SAME * spacing)).astype(np.int64)
    _, rows = np.unique(cells, axis=0, return_index=True)
    return points[np.sort(rows)]


def grid(*axes: NDArray[Any]) -> Points:
    """Return the points (N, D) of a grid with the given coordinates along its D axes."""
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return points.reshape(-1, len(axes)).astype(np.float64)
