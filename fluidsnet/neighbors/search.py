"""Neighbor search: interface of the backends, and the neighbor list they return."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from fluidsnet.particles import Particles


@dataclass(frozen=True)
class Neighbors:
    """Edges from fluid particles to their neighbors, sorted by particle (CSR).

    Attributes:
        particle: (E,) int64, row of the fluid particle; ascending.
        neighbor: (E,) int64, row among the fluid particles followed by the solid ones.
        offset: (N + 1,) int64, particle i has the edges offset[i] to offset[i + 1].
    """

    particle: Tensor
    neighbor: Tensor
    offset: Tensor

    @classmethod
    def from_edges(cls, particle: Tensor, neighbor: Tensor, particles: int) -> Neighbors:
        """Build from edges (E,) with ascending `particle`, and the number of fluid particles."""
        counts = torch.bincount(particle, minlength=particles)
        offset = torch.cat([counts.new_zeros(1), counts.cumsum(0)])
        return cls(particle, neighbor, offset)


class NeighborSearch(ABC):
    """Search for the nearest particles within the support radius (paper, section 4.3).

    Neighbors of a fluid particle are the other particles of its frame, fluid or solid, at a
    distance of at most the support radius; a second particle at the same place is one. Where
    there are more than `k`, the k nearest count; of equally far ones, the lower rows.

    Args:
        k: Maximum number of neighbors of a particle.
    """

    def __init__(self, k: int = 32) -> None:
        if k < 1:
            raise ValueError(f"k is {k}; a neighbor search needs k of 1 or more.")
        self.k = k

    @abstractmethod
    def __call__(self, particles: Particles) -> Neighbors:
        """Return the neighbors of each fluid particle, the nearest first."""
