"""Every pair of particles: slow, plainly right, the reference of the tests."""

from __future__ import annotations

from typing import final

import torch

from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles


@final
class BruteForce(NeighborSearch):
    """Compares each fluid particle with every particle; memory grows with the square."""

    def __call__(self, particles: Particles) -> Neighbors:
        everyone = torch.cat([particles.position, particles.solid_position])
        frame = torch.cat([particles.frame, particles.solid_frame])
        count = len(particles)
        offsets = everyone[None, :, :] - particles.position[:, None, :]
        squared = offsets.square().sum(dim=-1)
        allowed = squared <= particles.scene.support_radius**2
        allowed &= frame[None, :] == particles.frame[:, None]
        rows = torch.arange(count, device=everyone.device)
        allowed[rows, rows] = False
        # A stable sort keeps the lower row first among the equally far.
        order = squared.masked_fill(~allowed, torch.inf).argsort(dim=1, stable=True)[:, : self.k]
        kept = allowed.gather(1, order)
        return Neighbors.from_edges(
            rows[:, None].expand_as(order)[kept], order[kept], particles=count
        )
