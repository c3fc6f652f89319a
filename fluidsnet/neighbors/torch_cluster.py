"""The true k nearest of torch-cluster, cut at the support radius."""

from __future__ import annotations

from typing import final

import torch
from torch_cluster import knn

from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles


@final
class TorchCluster(NeighborSearch):
    """torch-cluster's ``knn``: a k-d tree on the CPU, every pair on a GPU.

    Its radius search is not used: beyond its cap it keeps arbitrary neighbors, not the
    nearest. Of neighbors that are equally far at the cap, it keeps whichever it finds first.
    """

    def __call__(self, particles: Particles) -> Neighbors:
        count = len(particles)
        everyone = torch.cat([particles.position, particles.solid_position])
        frame = torch.cat([particles.frame, particles.solid_frame])
        # knn needs each frame's particles side by side.
        order = frame.argsort(stable=True)
        # One more than k, since a particle is its own nearest.
        particle, neighbor = knn(
            everyone[order],
            particles.position,
            self.k + 1,
            batch_x=frame[order],
            batch_y=particles.frame,
            batch_size=particles.frames,
        )
        neighbor = order[neighbor]
        squared = (everyone[neighbor] - particles.position[particle]).square().sum(dim=-1)
        itself = neighbor == particle
        # Where more than k lie at its very place, a particle may not be among its own k + 1:
        # what counts is the rank among the others.
        start = Neighbors.from_edges(particle, neighbor, particles=count).offset[particle]
        before = torch.cat([start.new_zeros(1), itself.cumsum(0)])
        edge = torch.arange(len(particle), device=particle.device)
        rank = (edge - start) - (before[edge] - before[start])
        kept = ~itself & (rank < self.k) & (squared <= particles.scene.support_radius**2)
        return Neighbors.from_edges(particle[kept], neighbor[kept], particles=count)
