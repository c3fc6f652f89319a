"""Exact neighbors on any device: a cell list in torch operations alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import final

import torch
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles

# A hair wider than the support radius, so that no rounding puts a neighbor two cells away.
_WIDTH = 1.00001
# Of the particles whose position is not finite; no cell has it.
_NOWHERE = torch.iinfo(torch.int64).max


@final
class CellList(NeighborSearch):
    """A cell list of sorts and look-ups: exact, of linear cost, made for a GPU.

    Particles are sorted by cell, each as wide as the support radius, and each looks
    through the 27 around it. Fluid and solids are sorted apart; while the solids rest, their
    order is kept from call to call. Distances are compared in float32.

    Args:
        k: the most neighbors a particle has.
        pairs: pairs looked at together, some 60 bytes each; bounds the memory, unless one
            particle alone has more around it.
    """

    def __init__(self, k: int = 32, pairs: int = 2**23) -> None:
        super().__init__(k)
        if pairs < 1:
            raise ValueError(f"pairs is {pairs}; at least one has to be looked at.")
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

    A cell's number is made of four fields, from high to low: frame, z, y, x. So three
    cells along x have three numbers in a row. Far out, more than some hundred thousand cells
    from the origin (fewer with many frames), y and z repeat and x stops: cells are shared
    there, and no neighbor is lost.

    Attributes:
        position: (P, 3) m.
        row: (P,) int64 of each before they were sorted.
        number: (P,) int64 of their cells; ascending.
        bits: of each of z, y, x in a number.
    """

    position: Tensor
    row: Tensor
    number: Tensor
    bits: int

    @classmethod
    def sorted(cls, position: Tensor, frame: Tensor, frames: int, radius: float) -> SortedCells:
        """From positions (P, 3) in m, frames (P,), their number, and the support radius in m."""
        bits = (63 - frames.bit_length()) // 3
        size = 2**bits
        # A radius of zero is allowed: then only who shares a place is a neighbor.
        cell = (position.double() / max(_WIDTH * radius, 1e-30)).floor()
        finite = cell.isfinite().all(dim=1)
        cell = cell.nan_to_num(0.0, 0.0, 0.0)
        x = (cell[:, 0] + size // 2).clamp(1, size - 2).long()
        y, z = cell[:, 1:].remainder(size).long().unbind(dim=1)
        number = (((frame << bits | z) << bits | y) << bits | x).where(finite, _NOWHERE)
        number, row = number.sort(stable=True)
        return cls(position[row], row, number, bits)

    def occupied(self) -> tuple[Tensor, Tensor]:
        """The cells' numbers (C,), and in which of them each particle is (P,), by row."""
        cell, of_sorted = self.number.unique_consecutive(  # type: ignore[no-untyped-call]
            return_inverse=True
        )
        return cell, torch.empty_like(of_sorted).scatter_(0, self.row, of_sorted)

    def around(self, cell: Tensor, first: int = 0) -> tuple[Tensor, Tensor]:
        """Runs of particles around cells: their begins and lengths, (C, 9) each.

        Args:
            cell: (C,) numbers.
            first: added to the begins.
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
    """First and last rows of chunks of particles with about so many candidates (N,) at most."""
    chunk = candidates.cumsum(0).div(pairs, rounding_mode="floor")
    _, sizes = chunk.unique_consecutive(return_counts=True)  # type: ignore[no-untyped-call]
    ends = [0, *sizes.cumsum(0).tolist()]
    return list(pairwise(ends))


def _within(
    position: Tensor, others: Tensor, begin: Tensor, length: Tensor, limit: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Pairs (E,) no further apart than the limit.

    Args:
        position: (n, 3) of the particles, m.
        others: (P, 3) of all, m.
        begin: (n, R) of the runs of others around a particle.
        length: (n, R) of the same.
        limit: m².

    Returns:
        The particle, ascending; the squared distance; the index of the other.
    """
    runs, lengths = begin.shape[1], length.flatten()
    run = torch.arange(len(lengths), device=lengths.device).repeat_interleave(lengths)
    # Where a run begins among all, less where it begins among the pairs.
    shift = begin.flatten() - (lengths.cumsum(0) - lengths)
    other = torch.arange(len(run), device=run.device) + shift[run]
    particle = run.div_(runs, rounding_mode="floor")
    squared = (others[other] - position[particle]).square().sum(dim=-1)
    near = squared <= limit
    return particle[near], squared[near], other[near]


def _nearest(particle: Tensor, squared: Tensor, row: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """The first k of each particle by squared distance, then row; all (E,)."""
    # The bits of a float that is not negative sort as it does.
    order = (squared.view(torch.int32).long() << 32 | row).argsort()
    order = order[particle[order].argsort(stable=True)]
    particle, row = particle[order], row[order]
    edge = torch.arange(len(particle), device=particle.device)
    kept = edge - torch.searchsorted(particle, particle) < k
    return particle[kept], row[kept]
