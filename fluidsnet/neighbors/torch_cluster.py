"""The k nearest neighbors of torch-cluster, cut at the support radius."""

from __future__ import annotations

from typing import final

import torch

from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles
from fluidsnet.torch_extensions import knn


@final
class TorchCluster(NeighborSearch):
    """torch-cluster's ``knn``: a k-d tree on the CPU, brute force on a GPU.

    Its radius search is not used, since it keeps arbitrary neighbors beyond its cap. Of equally
    far neighbors at the cap, ``knn`` keeps the first that it finds.
    """

    def __call__(self, particles: Particles) -> Neighbors:
        count = len(particles)
        position = torch.cat([particles.position, particles.solid_position])
        frame = torch.cat([particles.frame, particles.solid_frame])
        # knn needs the particles sorted by frame.
        order = frame.argsort(stable=True)
        # One more than k, since a particle is its nearest neighbor.
        particle, neighbor = knn(
            position[order],
            particles.position,
            self.k + 1,
            batch_x=frame[order],
            batch_y=particles.frame,
            batch_size=particles.frames,
        )
        neighbor = order[neighbor]
        squared = (position[neighbor] - particles.position[particle]).square().sum(dim=-1)
        itself = neighbor == particle
        # A particle with more than k others at its place may be missing among its k + 1, so the
        # rank is counted without it.
        start = Neighbors.from_edges(particle, neighbor, particles=count).offset[particle]
        before = torch.cat([start.new_zeros(1), itself.cumsum(0)])
        edge = torch.arange(len(particle), device=particle.device)
        rank = (edge - start) - (before[edge] - before[start])
        kept = ~itself & (rank < self.k) & (squared <= particles.scene.support_radius**2)
        return Neighbors.from_edges(particle[kept], neighbor[kept], particles=count)
