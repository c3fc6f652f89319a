"""SPH kernel and the volumes of solid particles."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from fluidsnet.neighbors.auto import Auto
from fluidsnet.neighbors.search import NeighborSearch
from fluidsnet.particles import Particles

#: More neighbors than this, in fluid about six times too dense, are cut to the nearest ones.
NEIGHBORS = 256


def spline_height(support: float, dimension: int) -> float:
    """Return the kernel W at a distance of zero, 1/m³, or 1/m² in two dimensions.

    Args:
        support: Support radius, m.
        dimension: 2 or 3; the integral of W over that space is 1.
    """
    return (8 / math.pi if dimension == 3 else 40 / (7 * math.pi)) / float(support**dimension)


def cubic_spline(distance: Tensor, support: float, dimension: int = 3) -> Tensor:
    """Return the kernel W, 1/m³, of distances in m; zero from the support radius (m) on."""
    q = (distance / support).clamp(max=1)
    near = 6 * (q**3 - q**2) + 1
    return spline_height(support, dimension) * near.where(q <= 0.5, 2 * (1 - q) ** 3)


def spline_slope(distance: Tensor, support: float, dimension: int = 3) -> Tensor:
    """Return the derivative of `cubic_spline` by the distance, 1/m⁴."""
    q = (distance / support).clamp(max=1)
    near = 18 * q**2 - 12 * q
    return spline_height(support, dimension) / support * near.where(q <= 0.5, -6 * (1 - q) ** 2)


def solid_volumes(particles: Particles, search: NeighborSearch | None = None) -> Tensor:
    """Return the volume 1/ΣW of each solid particle (Akinci et al. 2012), (M,) float64 m³.

    The sum is over the solids around it, itself included.

    Args:
        particles: Particles with M solid ones.
        search: Neighbor search; `Auto` by default.
    """
    position, radius = particles.solid_position, particles.scene.support_radius
    solids = Particles(
        position=position,
        velocity=particles.solid_velocity,
        frame=particles.solid_frame,
        solid_position=position[:0],
        solid_velocity=position[:0],
        solid_frame=particles.solid_frame[:0],
        frames=particles.frames,
        scene=particles.scene,
    )
    edges = (search or Auto(NEIGHBORS))(solids)
    distance = edge_lengths(position, position, edges.particle, edges.neighbor)
    dimension = particles.scene.dimension
    center = cubic_spline(distance.new_zeros(()), radius, dimension).repeat(len(position))
    return 1 / center.index_add_(0, edges.particle, cubic_spline(distance, radius, dimension))


def edge_lengths(position: Tensor, both: Tensor, particle: Tensor, neighbor: Tensor) -> Tensor:
    """Return the length of each edge, (E,) float64 m."""
    offset = both.index_select(0, neighbor) - position.index_select(0, particle)
    length: Tensor = torch.linalg.vector_norm(offset, dim=1, dtype=torch.float64)
    return length
