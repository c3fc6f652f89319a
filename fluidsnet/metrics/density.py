"""SPH's density of a state, as the solver computes it."""

from __future__ import annotations

import math
from typing import final

import torch
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.neighbors.auto import Auto
from fluidsnet.neighbors.search import NeighborSearch
from fluidsnet.particles import Particles

# A particle at rest has some 40 neighbors in its support. Beyond this many the farthest, which
# weigh least, are left out: that is fluid about six times too dense.
_NEIGHBORS = 256


@final
class Density:
    """ρ/ρ₀ = V (W(0) + Σ W(x - x_j)) + Σ V_b W(x - x_b), over fluid j and solids b.

    W is the cubic spline kernel that ends at the support radius, V = (2r)³ the volume of a
    fluid particle of radius r, and V_b = 1 / Σ W(x_b - x_k) over the solids k, b itself among
    them, the volume of a solid one (Akinci et al. 2012). It is the solver's density: in its own
    frames the median is 1.000, and at walls it is up to 1 % more. ρ₀ cancels. Data of a solver
    that gives its particles another mass are off by a factor, and so is their truth.

    Args:
        search: for neighbors; its `k` is the most that count.
    """

    def __init__(self, search: NeighborSearch | None = None) -> None:
        self.search = search or Auto(_NEIGHBORS)
        # The solids' own search keeps their cells apart from those that lie around a fluid.
        self._volumes: TensorCache[Tensor] = TensorCache()

    def __call__(self, particles: Particles) -> Tensor:
        """ρ/ρ₀ of each fluid particle, (N,) float64; NaN where its position is not finite."""
        radius, scene = particles.scene.support_radius, particles.scene
        fluid = (2 * scene.particle_radius) ** 3
        solids = self._volumes.get(
            (particles.solid_position, particles.solid_frame),
            (radius, particles.frames),
            lambda position, frame: self._solid_volumes(particles),
        )
        volumes = torch.cat([solids.new_full((len(particles),), fluid), solids])
        everyone = torch.cat([particles.position, particles.solid_position])
        edges = self.search(particles)
        distance = _distance(particles.position, everyone, edges.particle, edges.neighbor)
        own = fluid * cubic_spline(distance.new_zeros(()), radius)
        density = own.repeat(len(particles)).index_add_(
            0, edges.particle, volumes[edges.neighbor] * cubic_spline(distance, radius)
        )
        return density.where(particles.position.isfinite().all(dim=1), torch.nan)

    def _solid_volumes(self, particles: Particles) -> Tensor:
        """V_b of each solid particle, (M,) float64, m³."""
        position, radius = particles.solid_position, particles.scene.support_radius
        alone = Particles(
            position=position,
            velocity=particles.solid_velocity,
            frame=particles.solid_frame,
            solid_position=position[:0],
            solid_velocity=position[:0],
            solid_frame=particles.solid_frame[:0],
            frames=particles.frames,
            scene=particles.scene,
        )
        edges = self.search(alone)
        distance = _distance(position, position, edges.particle, edges.neighbor)
        own = cubic_spline(distance.new_zeros(()), radius).repeat(len(position))
        return 1 / own.index_add_(0, edges.particle, cubic_spline(distance, radius))


def cubic_spline(distance: Tensor, support: float) -> Tensor:
    """The kernel W, 1/m³, of distances in m; zero from the support radius on, m."""
    q = (distance / support).clamp(max=1)
    near = 6 * (q**3 - q**2) + 1
    return 8 / (math.pi * support**3) * near.where(q <= 0.5, 2 * (1 - q) ** 3)


def _distance(position: Tensor, everyone: Tensor, particle: Tensor, neighbor: Tensor) -> Tensor:
    """Of each edge, (E,) float64, m."""
    offset = everyone.index_select(0, neighbor) - position.index_select(0, particle)
    distance: Tensor = torch.linalg.vector_norm(offset, dim=1, dtype=torch.float64)
    return distance
