"""SPH density of a state as the solver computes it, and `density_error`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import torch
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.metrics.base import RolloutMetric
from fluidsnet.neighbors.auto import Auto
from fluidsnet.neighbors.search import NeighborSearch
from fluidsnet.particles import Particles

# A particle at rest has about 40 neighbors. More than this many, in fluid about six times too
# dense, are cut to the nearest ones, which weigh most.
_NEIGHBORS = 256


@final
class Density:
    """SPH density over the rest density, as the solver computes it.

    ρ/ρ₀ = V (W(0) + Σ W(x - x_j)) + Σ V_b W(x - x_b), over fluid j and solids b.
    W is the cubic spline kernel that ends at the support radius, V = (2r)³ the volume of a
    fluid particle of radius r, and V_b = 1 / Σ W(x_b - x_k) the volume of a solid particle, over
    the solids k with b among them (Akinci et al. 2012). In frames of the solver the median is
    1.000, and up to 1 % more at walls. The masses cancel: data of a solver that gives its
    particles another mass are off by a factor, the truth as well as predictions.

    Args:
        search: Neighbor search; its `k` is the greatest number of neighbors that count.
    """

    def __init__(self, search: NeighborSearch | None = None) -> None:
        self.search = search or Auto(_NEIGHBORS)
        self._volumes: TensorCache[Tensor] = TensorCache()

    def __call__(self, particles: Particles) -> Tensor:
        """Return ρ/ρ₀ of each fluid particle, (N,) float64; NaN if its position is not finite."""
        radius, scene = particles.scene.support_radius, particles.scene
        fluid = (2 * scene.particle_radius) ** 3
        solids = self._volumes.get(
            (particles.solid_position, particles.solid_frame),
            (radius, particles.frames),
            lambda position, frame: self._solid_volumes(particles),
        )
        volumes = torch.cat([solids.new_full((len(particles),), fluid), solids])
        both = torch.cat([particles.position, particles.solid_position])
        edges = self.search(particles)
        distance = _edge_lengths(particles.position, both, edges.particle, edges.neighbor)
        center = fluid * cubic_spline(distance.new_zeros(()), radius)
        density = center.repeat(len(particles)).index_add_(
            0, edges.particle, volumes[edges.neighbor] * cubic_spline(distance, radius)
        )
        return density.where(particles.position.isfinite().all(dim=1), torch.nan)

    def _solid_volumes(self, particles: Particles) -> Tensor:
        """Return V_b of each solid particle, (M,) float64, m³."""
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
        edges = self.search(solids)
        distance = _edge_lengths(position, position, edges.particle, edges.neighbor)
        center = cubic_spline(distance.new_zeros(()), radius).repeat(len(position))
        return 1 / center.index_add_(0, edges.particle, cubic_spline(distance, radius))


@final
class DensityError(RolloutMetric):
    """Excess density max(0, ρ/ρ₀ - 1) after n steps: mean and 99.9th percentile.

    A density below 1 is no error, since it is normal at a surface. Compare with the truth's value,
    which is above zero because of the solver's tolerance and first frames, and of other masses.

    Args:
        simulations: As for `RolloutMetric`.
        steps: As for `RolloutMetric`.
        density: Density to share between metrics, so that the solids' volumes are computed once.
    """

    names = ("density_error", "density_error_999")
    components = 2
    costly = True
    of_truth = True

    def __init__(
        self, simulations: Sequence[int], steps: int, density: Density | None = None
    ) -> None:
        super().__init__(simulations, steps)
        self.density = density or Density()

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        excess = (self.density(predicted) - 1).clamp_min(0)
        errors = torch.stack([excess.mean(), excess.quantile(0.999)])
        return errors.where(excess.isfinite().all(), torch.inf)


def cubic_spline(distance: Tensor, support: float) -> Tensor:
    """Return the kernel W, 1/m³, of distances in m; zero from the support radius (m) on."""
    q = (distance / support).clamp(max=1)
    near = 6 * (q**3 - q**2) + 1
    return 8 / (math.pi * support**3) * near.where(q <= 0.5, 2 * (1 - q) ** 3)


def _edge_lengths(position: Tensor, both: Tensor, particle: Tensor, neighbor: Tensor) -> Tensor:
    """Return the length of each edge, (E,) float64 m."""
    offset = both.index_select(0, neighbor) - position.index_select(0, particle)
    length: Tensor = torch.linalg.vector_norm(offset, dim=1, dtype=torch.float64)
    return length
