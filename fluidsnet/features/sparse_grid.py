"""Sparse voxel grid: the cells around particles, and coarser levels of the cells that hold them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor, nn

from fluidsnet.features.morton import coordinate_bits, encode, keys_around


@dataclass(frozen=True)
class Level:
    """Cells of one size, C in all frames, in Morton order.

    Attributes:
        neighbor: (C, 27) int64, rows of the 3 x 3 x 3 cells around each, x the fastest; C where
            there is no cell.
        offset: (C + 1,) int64; cell c holds the rows offset[c] to offset[c + 1] of the next finer
            level, and in the finest level so many particles of `SparseGrid.order`.
    """

    neighbor: Tensor
    offset: Tensor

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.neighbor)


@dataclass(frozen=True)
class SparseGrid:
    """Cells of a batch of frames, and where the particles are between their centers.

    A particle is in the box between the centers of eight cells, which all exist. There are no
    other cells in the finest level, so their number follows that of the particles.

    Attributes:
        levels: Finest first; a cell of the next is two cells wide along each axis.
        order: (N,) int64, rows of the particles, sorted by cell.
        corner: (N, 8) int64, rows of the cells at the corners of each particle's box.
        weight: (N, 8) trilinear weights of the corners; differentiable.
    """

    levels: list[Level]
    order: Tensor
    corner: Tensor
    weight: Tensor

    @classmethod
    def around(cls, position: Tensor, frame: Tensor, frames: int, levels: int) -> SparseGrid:
        """Build the grid around particles.

        Positions are clamped to 2^19 cells from the origin, or fewer in batches of more than 7
        frames, and a position that is NaN counts as 0.

        Args:
            position: (N, 3) in cells; cell 0 covers 0 to 1 along each axis.
            frame: (N,) int64.
            frames: Number of frames.
            levels: Number of levels.
        """
        bits = coordinate_bits(frames)
        # A multiple of the coarsest cell; the margin keeps neighbors in each level in range.
        origin, margin = 2 ** (bits - 1), 2**levels
        place = position.nan_to_num(0.0) - 0.5
        place = place.clamp(margin - origin, origin - margin - 2)
        lower = place.detach().floor()
        fraction = place - lower
        with torch.no_grad():
            key = encode(lower.long() + origin, frame, bits)
            box, index = key.unique(return_inverse=True)  # type: ignore[no-untyped-call]
            cell, corner = keys_around(box, (0, 1), bits).unique(  # type: ignore[no-untyped-call]
                return_inverse=True
            )
            corner = corner.index_select(0, index)
            x, y, z = (fraction >= 0.5).long().unbind(dim=1)
            own = corner.gather(1, (x + 2 * y + 4 * z)[:, None]).squeeze(1)
            # 32 bits are sorted in half the time of 64.
            own, order = own.int().sort(stable=True)
            rows = torch.arange(len(cell) + 1, device=cell.device, dtype=own.dtype)
            offset = torch.searchsorted(own, rows)
            found = _levels(cell, offset, bits, levels)
        return cls(found, order, corner, _weights(fraction))

    def sample(self, field: Tensor) -> Tensor:
        """Interpolate a field at the particles, (N, channels).

        Args:
            field: (C, channels) values at the centers of the finest cells.
        """
        # The weighted sum over the corners; its backward pass sums rows in order.
        return nn.functional.embedding_bag(
            self.corner, field, per_sample_weights=self.weight.to(field.dtype), mode="sum"
        )


def _weights(fraction: Tensor) -> Tensor:
    """Return the trilinear weights (N, 8) of positions (N, 3) in a box of edges 1, x fastest."""
    x, y, z = torch.stack([1 - fraction, fraction], dim=2).unbind(dim=1)
    return (z[:, :, None, None] * y[:, None, :, None] * x[:, None, None, :]).flatten(1)


def _levels(cell: Tensor, offset: Tensor, bits: int, count: int) -> list[Level]:
    """Return the levels from the keys (C,) of the finest cells and their offsets (C + 1,)."""
    cells, offsets, parents = [cell], [offset], []
    for _ in range(count - 1):
        coarse, parent, children = (cells[-1] >> 3).unique_consecutive(  # type: ignore[no-untyped-call]
            return_inverse=True, return_counts=True
        )
        cells.append(coarse)
        parents.append(parent)
        offsets.append(nn.functional.pad(children.cumsum(0), (1, 0)))
    neighbors = [_search(cells[-1], bits - count + 1)]
    for cell, parent in zip(reversed(cells[:-1]), reversed(parents), strict=True):
        neighbors.append(_inherit(cell, parent, neighbors[-1]))
    return [Level(*level) for level in zip(reversed(neighbors), offsets, strict=True)]


def _search(cell: Tensor, bits: int) -> Tensor:
    """Return the neighbors (C, 27) of cells with ascending keys (C,)."""
    wanted = keys_around(cell, (-1, 0, 1), bits)
    row = torch.searchsorted(cell, wanted)
    # Past the last cell there is no key.
    found = nn.functional.pad(cell, (0, 1), value=-1)[row]
    return row.where(found == wanted, len(cell))


def _inherit(cell: Tensor, parent: Tensor, around_parent: Tensor) -> Tensor:
    """Return the neighbors (C, 27) of cells from those of their parents.

    A table is several times faster than a binary search.

    Args:
        cell: (C,) keys.
        parent: (C,) row of the coarser cell that holds each.
        around_parent: (P, 27) neighbors of the coarser cells.
    """
    octant = cell & 7
    # Row of the child in each octant of the coarser cells and of the one that does not exist.
    child = cell.new_full((8 * (len(around_parent) + 1),), len(cell))
    child[8 * parent + octant] = torch.arange(len(cell), device=cell.device)
    holder, within = torch.tensor(_STEPS, device=cell.device)[:, octant]
    return child[8 * around_parent.index_select(0, parent).gather(1, holder) + within]


def _steps() -> list[list[list[int]]]:
    """Return, for each octant and offset, the offset of the parent's neighbor and its octant."""
    holder, within = [], []
    for z, y, x in product(range(2), repeat=3):
        around = [(x + i, y + j, z + k) for k, j, i in product((-1, 0, 1), repeat=3)]
        holder.append([(i // 2 + 1) + 3 * (j // 2 + 1) + 9 * (k // 2 + 1) for i, j, k in around])
        within.append([i % 2 + 2 * (j % 2) + 4 * (k % 2) for i, j, k in around])
    return [holder, within]


_STEPS = _steps()
