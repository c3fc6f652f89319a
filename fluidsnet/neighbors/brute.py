"""Brute-force neighbor search, the reference of the tests."""

from __future__ import annotations

from typing import final

import torch

from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles


@final
class BruteForce(NeighborSearch):
    """Compare each fluid particle with all particles; memory grows with the square."""

    def __call__(self, particles: Particles) -> Neighbors:
        position = torch.cat([particles.position, particles.solid_position])
        frame = torch.cat([particles.frame, particles.solid_frame])
        count = len(particles)
        offsets = position[None, :, :] - particles.position[:, None, :]
        squared = offsets.square().sum(dim=-1)
        allowed = squared <= particles.scene.support_radius**2
        allowed &= frame[None, :] == particles.frame[:, None]
        rows = torch.arange(count, device=position.device)
        allowed[rows, rows] = False
        # A stable sort puts the lower of equally far rows first.
        order = squared.masked_fill(~allowed, torch.inf).argsort(dim=1, stable=True)[:, : self.k]
        kept = allowed.gather(1, order)
        return Neighbors.from_edges(
            rows[:, None].expand_as(order)[kept], order[kept], particles=count
        )
