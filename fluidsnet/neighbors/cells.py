"""Particles counted into cells on the CPU, compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from torch import Tensor

# CellTable per particle at most: what bounds the memory however far particles fly apart.
_CELLS_PER_PARTICLE = 4


class CellTable(NamedTuple):
    """P particles, one cell's after another's; each frame has cells of its own.

    Along an axis the cells repeat: `size` is all there are of them where there is room, and
    less where particles flew far apart. Who shares a cell may then be far away, but whoever
    is near is in the same cell or in one beside it.

    Attributes:
        start: (C + 2,) int32, cell c has the particles start[c] to start[c + 1]; after the C
            cells comes one, never looked into, for the positions that are not finite.
        row: (P,) int32 of each before they were sorted.
        place: (3, P) float32, m.
        frame: (P,) int32.
        size: (3,) int64, cells after which an axis repeats, x first; three at least, or a
            cell would meet itself on both sides.
        density: cells per m.
    """

    start: NDArray[np.int32]
    row: NDArray[np.int32]
    place: NDArray[np.float32]
    frame: NDArray[np.int32]
    size: NDArray[np.int64]
    density: float


def sort_into_cells(
    position: Tensor, frame: Tensor, frames: int, width: float, extent: list[float]
) -> CellTable:
    """Sorts particles into cells.

    Args:
        position: (P, 3) m.
        frame: (P,) in which each is.
        frames: number of them.
        width: of a cell, m.
        extent: (3,) of the domain, m; decides nothing but what is fast.
    """
    places = position.detach().cpu().float().contiguous().numpy()
    in_frame = frame.cpu().contiguous().numpy()
    room = _CELLS_PER_PARTICLE * len(places) / max(frames, 1)
    # One more than occupied, so that the ends of the occupied box do not meet.
    spans = (_spans(places, 1.0 / width) + 1.0).tolist()
    if np.prod(spans) > room:
        # A few that flew off must not take the cells of the many.
        spans = [
            min(span, max(edge / width, 0.0) + 2.0)
            for span, edge in zip(spans, extent, strict=True)
        ]
    size = np.empty(3, np.int64)
    # The short axes first: what they do not need is left to the long ones.
    for left, axis in zip((3, 2, 1), sorted(range(3), key=spans.__getitem__), strict=True):
        fair = max(room, 1.0) ** (1 / left)
        # Odd, because positions far out are multiples of a power of two.
        size[axis] = max(3, int(spans[axis]) if spans[axis] <= fair else int(fair) | 1)
        room /= size[axis]
    start, row, place, of = _sort(places, in_frame, frames, 1.0 / width, size)
    return CellTable(start, row, place, of, size, 1.0 / width)


@njit(cache=True, error_model="numpy")
def around(cells: CellTable, frame: int, cell: Any, begin: Any, end: Any, found: int) -> Any:
    """Appends to begin and end the runs of particles in and around a cell, 27 at most.

    Args:
        cells: to look into.
        frame: of the cell.
        cell: (3,) as `cell_of` numbers them.
        begin: (54,) of each run, appended to from `found`.
        end: (54,) of the same.
        found: runs there are.

    Returns:
        Runs there are now.
    """
    start, size = cells.start, cells.size
    x, y, z = _slot(cell[0], size[0]), _slot(cell[1], size[1]), _slot(cell[2], size[2])
    for dz in range(-1, 2):
        plane = (frame * size[2] + _beside(z + dz, size[2])) * size[1]
        for dy in range(-1, 2):
            line = (plane + _beside(y + dy, size[1])) * size[0]
            if 1 <= x < size[0] - 1:
                # Three cells along x lie side by side.
                begin[found], end[found] = start[line + x - 1], start[line + x + 2]
                found += end[found] > begin[found]
            else:
                for dx in range(-1, 2):
                    one = line + _beside(x + dx, size[0])
                    begin[found], end[found] = start[one], start[one + 1]
                    found += end[found] > begin[found]
    return found


@njit(cache=True, error_model="numpy")
def cell_of(coordinate: float, density: float) -> Any:
    """The cell a coordinate in m is in, as a whole float64."""
    return np.floor(np.float64(coordinate) * density)


@njit(cache=True, error_model="numpy")
def is_finite(x: float, y: float, z: float) -> Any:
    """Whether a place is one."""
    return np.isfinite(x) and np.isfinite(y) and np.isfinite(z)


@njit(cache=True, error_model="numpy")
def _slot(cell: float, size: int) -> Any:
    """Where a cell is among those that repeat; clipped, as beyond 2⁵³ floats have gaps."""
    return int(min(max(cell - size * np.floor(cell / size), 0.0), size - 1.0))


@njit(cache=True, error_model="numpy")
def _beside(slot: int, size: int) -> Any:
    """A slot one beyond either end, brought back."""
    if slot < 0:
        return slot + size
    return slot - size if slot >= size else slot


@njit(cache=True, error_model="numpy")
def _spans(place: Any, density: float) -> Any:
    """(3,) float64 cells from the first occupied one to the last, of finite places (P, 3)."""
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for x, y, z in place:
        if is_finite(x, y, z):
            lower[0], upper[0] = min(lower[0], x), max(upper[0], x)
            lower[1], upper[1] = min(lower[1], y), max(upper[1], y)
            lower[2], upper[2] = min(lower[2], z), max(upper[2], z)
    if upper[0] < lower[0]:
        return np.zeros(3)
    return np.floor(upper * density) - np.floor(lower * density) + 1.0


@njit(cache=True, parallel=True, error_model="numpy")
def _sort(place: Any, frame: Any, frames: int, density: float, size: Any) -> Any:
    """A counting sort: start, row, place and frame of `CellTable`."""
    count = len(place)
    cells = frames * size[0] * size[1] * size[2]
    cell = np.empty(count, np.int32)
    for i in prange(count):
        x, y, z = place[i, 0], place[i, 1], place[i, 2]
        cell[i] = cells
        if is_finite(x, y, z):
            slot = frame[i] * size[2] + _slot(cell_of(z, density), size[2])
            slot = slot * size[1] + _slot(cell_of(y, density), size[1])
            cell[i] = slot * size[0] + _slot(cell_of(x, density), size[0])
    # Counted two places late, so that start[c + 1] is where cell c begins, and moves to its end
    # while the cell fills.
    start = np.zeros(cells + 3, np.int32)
    for i in range(count):
        start[cell[i] + 2] += 1
    for c in range(2, cells + 3):
        start[c] += start[c - 1]
    row = np.empty(count, np.int32)
    for i in range(count):
        row[start[cell[i] + 1]] = i
        start[cell[i] + 1] += 1
    sorted_place = np.empty((3, count), np.float32)
    sorted_frame = np.empty(count, np.int32)
    for s in prange(count):
        sorted_frame[s] = frame[row[s]]
        for axis in range(3):
            sorted_place[axis, s] = place[row[s], axis]
    return start[:-1], row, sorted_place, sorted_frame
