"""Exact neighbors on any device: a cell list in torch operations."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import final

import torch
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles

# Cells are wider than the support radius, so that rounding puts no neighbor two cells away.
_WIDTH = 1.00001
# Cell number of particles whose position is not finite.
_NOWHERE = torch.iinfo(torch.int64).max


@final
class CellList(NeighborSearch):
    """Cell list of sorts and binary searches: exact, of linear cost, for a GPU.

    Particles are sorted into cells as wide as the support radius, and candidates come from the
    27 cells around each. Fluid and solids are sorted separately; the order of the solids is
    cached while they rest. Distances are compared in float32.

    Args:
        k: Maximum number of neighbors of a particle.
        pairs: Pairs that are compared at once, about 60 bytes each; bounds the memory unless
            one particle has more candidates.
    """

    def __init__(self, k: int = 32, pairs: int = 2**23) -> None:
        super().__init__(k)
        if pairs < 1:
            raise ValueError(f"pairs is {pairs}; CellList needs pairs of 1 or more.")
        self.pairs = pairs
        self._solids: TensorCache[SortedCells] = TensorCache()

    @torch.no_grad()
    def __call__(self, particles: Particles) -> Neighbors:
        radius, frames = particles.scene.support_radius, particles.frames

        def sort(position: Tensor, frame: Tensor) -> SortedCells:
            return SortedCells.sorted(position.float(), frame, frames, radius)

        fluid = sort(particles.position, particles.frame)
        solids = self._solids.get(
            (particles.solid_position, particles.solid_frame), (frames, radius), sort
        )
        count = len(particles)
        position = torch.cat([fluid.position, solids.position])
        row = torch.cat([fluid.row, count + solids.row])
        cell, cell_of_row = fluid.occupied()
        begin, length = (
            torch.cat(pair, dim=1)
            for pair in zip(fluid.around(cell), solids.around(cell, first=count), strict=True)
        )
        candidates = length.sum(dim=1)[cell_of_row]
        particle, neighbor = [row[:0]], [row[:0]]
        for first, last in _chunks(candidates, self.pairs):
            cells = cell_of_row[first:last]
            near, squared, other = _within(
                particles.position[first:last].float(),
                position,
                begin[cells],
                length[cells],
                radius**2,
            )
            other = row[other]
            itself = other == near + first
            near, other = _nearest(near[~itself], squared[~itself], other[~itself], self.k)
            particle.append(near + first)
            neighbor.append(other)
        return Neighbors.from_edges(torch.cat(particle), torch.cat(neighbor), particles=count)


@dataclass(frozen=True)
class SortedCells:
    """P particles in the order of their cells.

    A cell number has four bit fields, from high to low: frame, z, y, x; three cells along x
    have consecutive numbers. More than some hundred thousand cells from the origin (fewer with
    many frames) y and z wrap around and x is clamped: cells are shared, no neighbor is lost.

    Attributes:
        position: (P, 3) m.
        row: (P,) int64 row of each particle before sorting.
        number: (P,) int64 cell number; ascending.
        bits: Bits of each of z, y, x in a number.
    """

    position: Tensor
    row: Tensor
    number: Tensor
    bits: int

    @classmethod
    def sorted(cls, position: Tensor, frame: Tensor, frames: int, radius: float) -> SortedCells:
        """Sort positions (P, 3) in m with frames (P,); cells are as wide as the radius in m."""
        bits = (63 - frames.bit_length()) // 3
        size = 2**bits
        # At a radius of zero only particles at the same place are neighbors.
        cell = (position.double() / max(_WIDTH * radius, 1e-30)).floor()
        finite = cell.isfinite().all(dim=1)
        cell = cell.nan_to_num(0.0, 0.0, 0.0)
        x = (cell[:, 0] + size // 2).clamp(1, size - 2).long()
        y, z = cell[:, 1:].remainder(size).long().unbind(dim=1)
        number = (((frame << bits | z) << bits | y) << bits | x).where(finite, _NOWHERE)
        number, row = number.sort(stable=True)
        return cls(position[row], row, number, bits)

    def occupied(self) -> tuple[Tensor, Tensor]:
        """Return the occupied cell numbers (C,), and for each row the index of its cell (P,)."""
        cell, of_sorted = self.number.unique_consecutive(  # type: ignore[no-untyped-call]
            return_inverse=True
        )
        return cell, torch.empty_like(of_sorted).scatter_(0, self.row, of_sorted)

    def around(self, cell: Tensor, first: int = 0) -> tuple[Tensor, Tensor]:
        """Return begin and length of the runs of particles around cells, (C, 9) each.

        Args:
            cell: (C,) cell numbers.
            first: Added to the begins.
        """
        mask = 2**self.bits - 1
        step = torch.arange(-1, 2, device=cell.device)
        y = ((cell >> self.bits)[:, None] + step) & mask
        z = ((cell >> 2 * self.bits)[:, None] + step) & mask
        frame = cell >> 3 * self.bits
        plane = frame[:, None] << self.bits | z
        line = (plane[:, :, None] << self.bits | y[:, None, :]).flatten(1) << self.bits
        x = (cell & mask)[:, None]
        begin = torch.searchsorted(self.number, line | (x - 1))
        length = torch.searchsorted(self.number, line | (x + 1), right=True) - begin
        return begin + first, length.where((cell != _NOWHERE)[:, None], 0)


def _chunks(candidates: Tensor, pairs: int) -> list[tuple[int, int]]:
    """Return (first, last) of chunks of particles with about `pairs` candidates in all."""
    chunk = candidates.cumsum(0).div(pairs, rounding_mode="floor")
    _, sizes = chunk.unique_consecutive(return_counts=True)  # type: ignore[no-untyped-call]
    ends = [0, *sizes.cumsum(0).tolist()]
    return list(pairwise(ends))


def _within(
    position: Tensor, others: Tensor, begin: Tensor, length: Tensor, limit: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return particle (ascending), squared distance and candidate of the pairs (E,) in reach.

    Positions (n, 3) and those of the candidates (P, 3) are in m, the limit in m²; begin and
    length (n, R) are the runs of candidates around each particle.
    """
    runs, lengths = begin.shape[1], length.flatten()
    run = torch.arange(len(lengths), device=lengths.device).repeat_interleave(lengths)
    # Begin of a run among the candidates, less its begin among the pairs.
    shift = begin.flatten() - (lengths.cumsum(0) - lengths)
    other = torch.arange(len(run), device=run.device) + shift[run]
    particle = run.div_(runs, rounding_mode="floor")
    squared = (others[other] - position[particle]).square().sum(dim=-1)
    near = squared <= limit
    return particle[near], squared[near], other[near]


def _nearest(particle: Tensor, squared: Tensor, row: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Keep the first k pairs of each particle by squared distance, then row; all (E,)."""
    # The bits of a nonnegative float sort like the float.
    order = (squared.view(torch.int32).long() << 32 | row).argsort()
    order = order[particle[order].argsort(stable=True)]
    particle, row = particle[order], row[order]
    edge = torch.arange(len(particle), device=particle.device)
    kept = edge - torch.searchsorted(particle, particle) < k
    return particle[kept], row[kept]
