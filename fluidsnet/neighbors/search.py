"""What every backend takes and gives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from fluidsnet.neighbors.cells import CellTable
from fluidsnet.particles import Particles


@dataclass(frozen=True)
class Neighbors:
    """Edges from fluid particles to their neighbors, one particle's after another's.

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
        """From edges (E,) whose `particle` ascends, and the number of fluid particles."""
        counts = torch.bincount(particle, minlength=particles)
        offset = torch.cat([counts.new_zeros(1), counts.cumsum(0)])
        return cls(particle, neighbor, offset)


class NeighborSearch(ABC):
    """Finds the nearest particles within the support radius (paper, section 4.3).

    A neighbor is any other particle of the same frame, fluid or solid, at a distance of
    at most the support radius; a second particle at the same place is one. Where there
    are more than `k`, the k nearest count; among those equally far, the lower rows.

    Args:
        k: the most neighbors a particle has.
    """

    def __init__(self, k: int = 32) -> None:
        if k < 1:
            raise ValueError(f"k is {k}; a particle needs room for one neighbor at least.")
        self.k = k

    @abstractmethod
    def __call__(self, particles: Particles) -> Neighbors:
        """The neighbors of each fluid particle, the nearest first."""

    def cells(self, particles: Particles) -> tuple[CellTable, CellTable] | None:
        """Fluid and solid particles sorted into cells as wide as the support radius.

        For who looks for neighbors without storing them; None where the backend has no such
        cells on the CPU.
        """
        return None
