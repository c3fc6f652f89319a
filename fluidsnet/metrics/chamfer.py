"""`chamfer`: how far the nearest particle of the other state is."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor
from torch_cluster import knn

from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class Chamfer(RolloutMetric):
    """Symmetric chamfer distance after n steps, mm.

    ½ (mean over x̂ of the distance to the nearest x + mean over x of that to the nearest x̂):
    distances, not their squares, over all fluid particles. Two states of the same fluid, its
    particles otherwise placed, are apart by about a particle radius.
    """

    names = ("chamfer_mm",)
    costly = True

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        there, here = predicted.position, true.position
        # A search tree has no place for what is nowhere.
        finite, there = there.isfinite().all(), there.nan_to_num(0.0, 0.0, 0.0)
        distance = (nearest(there, here).mean() + nearest(here, there).mean()) / 2
        return (1000 * distance).where(finite, torch.inf)[None]


def nearest(points: Tensor, others: Tensor) -> Tensor:
    """Distance from each point to the nearest of the others: (N,) float64, m.

    Args:
        points: (N, 3) finite, m.
        others: (P, 3) finite, m.
    """
    point, other = knn(others, points, 1)
    offsets = points[point].double() - others[other].double()
    # So far away that float32 overflows, a point has no nearest.
    distance = offsets.new_full((len(points),), torch.inf)
    distance[point] = torch.linalg.vector_norm(offsets, dim=1)
    return distance
