"""Metrics of the fluid as a point cloud, without an order of particles: chamfer and Sinkhorn."""

from __future__ import annotations

import math
from typing import final

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from fluidsnet.metrics.base import RolloutMetric
from fluidsnet.particles import Particles
from fluidsnet.torch_extensions import knn

#: Number of particles that `Sinkhorn` draws from each state.
SAMPLE = 256
_SEED = 0

# Iterations with products. On pairs of states of dam breaks the error left is below 1 %.
_ITERATIONS, _SELF_ITERATIONS = 200, 30


@final
class Chamfer(RolloutMetric):
    """Symmetric chamfer distance after n steps, mm.

    ½ (mean over x̂ of the distance to the nearest x + mean over x of the distance to the nearest
    x̂), of distances, not squares, over all fluid particles. Two states of one fluid with
    different positions of the particles are about a particle radius apart.
    """

    names = ("chamfer_mm",)
    costly = True

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        position, finite = _finite(predicted.position)
        there, back = nearest(position, true.position), nearest(true.position, position)
        return (1000 * (there.mean() + back.mean()) / 2).where(finite, torch.inf)[None]


@final
class Sinkhorn(RolloutMetric):
    """Sinkhorn divergence of 256 of the particles after n steps, m².

    S = OT(x̂, x) - ½ OT(x̂, x̂) - ½ OT(x, x), where OT is the entropic optimal transport cost with
    squared distances and the regularization ε = (support radius)² (Feydy et al. 2019; LagrangeBench
    has another ε), so differences below the support radius do not count. A fluid shifted by d
    has S = d².

    The sample of 256 particles is drawn with a fixed seed, the same in both states, since the cost
    of the metric grows with the square of the number. On dam breaks of 2,700 particles a sample of
    1,024 differs by some 5 %, and more iterations by 1 %.
    """

    names = (f"sinkhorn_{SAMPLE}_m2",)
    costly = True

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        random = torch.Generator("cpu").manual_seed(_SEED)
        rows = torch.randperm(len(true), generator=random)[:SAMPLE].to(true.position.device)
        position, finite = _finite(predicted.position)
        radius = true.scene.support_radius
        divergence = sinkhorn_divergence(position[rows], true.position[rows], radius)
        return divergence.where(finite, torch.inf)[None]


def _finite(position: Tensor) -> tuple[Tensor, Tensor]:
    """Return the positions with zeros where not finite, and whether all are finite, ()."""
    return position.nan_to_num(0.0, 0.0, 0.0), position.isfinite().all()


def nearest(points: Tensor, others: Tensor) -> Tensor:
    """Return the distance from each point to the nearest of the others, (N,) float64 m.

    Args:
        points: (N, 3) finite, m.
        others: (P, 3) finite, m.
    """
    if points.device.type == "cpu":
        tree = cKDTree(others.double().numpy())
        found, _ = tree.query(points.double().numpy(), workers=torch.get_num_threads())
        return torch.from_numpy(found)
    point, other = knn(others, points, 1)
    offsets = points[point].double() - others[other].double()
    # knn finds none for a point so far away that float32 overflows.
    distance = offsets.new_full((len(points),), torch.inf)
    distance[point] = torch.linalg.vector_norm(offsets, dim=1)
    return distance


def sinkhorn_divergence(x: Tensor, y: Tensor, blur: float, iterations: int = _ITERATIONS) -> Tensor:
    """Return S of two clouds of equally many points of equal weight, () float64 m².

    Args:
        x: (n, 3) m.
        y: (n, 3) m.
        blur: √ε, m.
        iterations: Iterations for OT(x, y).
    """
    x, y, epsilon = x.double(), y.double(), blur**2
    x_self, y_self = _self_potential(x, epsilon), _self_potential(y, epsilon)
    # The start `y_self` is the solution where the clouds are the same, and S is then zero.
    f, g = _potentials(_squared_distances(x, y), y_self, epsilon, iterations)
    # At convergence the dual objective is the cost with its entropy.
    return f.mean() + g.mean() - x_self.mean() - y_self.mean()


def _self_potential(x: Tensor, epsilon: float) -> Tensor:
    """Return the potential of OT(x, x), (n,); both potentials are the same."""
    # The diagonal is 1 / n, so no row vanishes.
    kernel = (_squared_distances(x, x) / -epsilon).exp_().div_(len(x))
    u = torch.ones_like(x[:, 0])
    for _ in range(_SELF_ITERATIONS):
        u = (u / (kernel @ u)).sqrt_()
    return epsilon * u.log()


def _potentials(cost: Tensor, g: Tensor, epsilon: float, iterations: int) -> tuple[Tensor, Tensor]:
    """Return both potentials, (n,) each, of the costs (n, n), from a start of the second one."""
    log_count = math.log(len(cost))
    # First in the log domain, which does not underflow, then with products, ten times as fast.
    f = -epsilon * torch.logsumexp((g - cost) / epsilon - log_count, dim=1)
    g = -epsilon * torch.logsumexp((f[:, None] - cost) / epsilon - log_count, dim=0)
    plan = ((f[:, None] + g - cost) / epsilon).exp_().div_(len(cost))
    u, v = torch.ones_like(f), torch.ones_like(g)
    for _ in range(iterations):
        torch.reciprocal(plan @ v, out=u)
        torch.reciprocal(plan.T @ u, out=v)
    return f + epsilon * u.log(), g + epsilon * v.log()


def _squared_distances(x: Tensor, y: Tensor) -> Tensor:
    sums = x.square().sum(dim=1)[:, None] + y.square().sum(dim=1)
    return (sums - 2 * x @ y.T).clamp_min(0)
