"""SPH density of a state as the solver computes it, and `density_error`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import torch
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.metrics.base import RolloutMetric
from fluidsnet.neighbors.auto import Auto
from fluidsnet.neighbors.search import NeighborSearch
from fluidsnet.particles import Particles
from fluidsnet.sph import NEIGHBORS, cubic_spline, edge_lengths, solid_volumes


@final
class Density:
    """SPH density over the rest density, as the solver computes it.

    ρ/ρ₀ = V (W(0) + Σ W(x - x_j)) + Σ V_b W(x - x_b), over fluid j and solids b.
    W is the cubic spline kernel that ends at the support radius, V = (2r)³ the volume of a
    fluid particle of radius r, (2r)² in two dimensions, and V_b = 1 / Σ W(x_b - x_k) the volume of
    a solid particle, over the solids k with b among them (Akinci et al. 2012). In frames of the
    solver the median is 1.000, and up to 1 % more at walls. The masses cancel: data of a solver
    that gives its particles another mass are off by a factor, the truth as well as predictions.

    Args:
        search: Neighbor search; its `k` is the greatest number of neighbors that count.
    """

    def __init__(self, search: NeighborSearch | None = None) -> None:
        self.search = search or Auto(NEIGHBORS)
        self._volumes: TensorCache[Tensor] = TensorCache()

    def __call__(self, particles: Particles) -> Tensor:
        """Return ρ/ρ₀ of each fluid particle, (N,) float64; NaN if its position is not finite."""
        radius, scene = particles.scene.support_radius, particles.scene
        fluid, dimension = scene.particle_volume, scene.dimension
        solids = self._volumes.get(
            (particles.solid_position, particles.solid_frame),
            (radius, particles.frames),
            lambda position, frame: solid_volumes(particles, self.search),
        )
        volumes = torch.cat([solids.new_full((len(particles),), fluid), solids])
        both = torch.cat([particles.position, particles.solid_position])
        edges = self.search(particles)
        distance = edge_lengths(particles.position, both, edges.particle, edges.neighbor)
        center = fluid * cubic_spline(distance.new_zeros(()), radius, dimension)
        weight = volumes[edges.neighbor] * cubic_spline(distance, radius, dimension)
        density = center.repeat(len(particles)).index_add_(0, edges.particle, weight)
        return density.where(particles.position.isfinite().all(dim=1), torch.nan)


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
