"""Selection of the k nearest neighbors among the candidates around a cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fluidsnet.kernels.cell_table import CellTable, around, cell_of

#: Particles per block of a thread.
BLOCK = 1024
#: Bins of distance of the bucket sort.
BINS = 64
#: Up to this many neighbors above k are dropped one by one; for more, all are sorted.
DROPPED = 8
#: Bits of a key that hold the row.
ROW = 0x7FFFFFFF


@njit(cache=True, error_model="numpy")
def enters(cells: CellTable, s: int, cell: Any) -> Any:
    """Write the cell of particle s of a table and return whether it differs from before.

    `cell` holds (4,) float64 coordinates x, y, z and frame; NaN before the first particle.
    """
    x = cell_of(cells.place[0, s], cells.density)
    y = cell_of(cells.place[1, s], cells.density)
    z = cell_of(cells.place[2, s], cells.density)
    frame = np.float64(cells.frame[s])
    if x == cell[0] and y == cell[1] and z == cell[2] and frame == cell[3]:
        return False
    cell[0], cell[1], cell[2], cell[3] = x, y, z, frame
    return True


@njit(cache=True, error_model="numpy")
def look_around(fluid: CellTable, solids: CellTable, cell: Any, begin: Any, end: Any) -> Any:
    """Write begin and end (54,) of the runs of candidates around a cell of `enters`.

    Returns:
        Number of runs of fluid particles, which come first, and of all runs.
    """
    runs = around(fluid, int(cell[3]), cell, begin, end, 0)
    return runs, around(solids, int(cell[3]), cell, begin, end, runs)


@njit(cache=True, error_model="numpy")
def collect(
    fluid: CellTable, solids: CellTable, begin: Any, end: Any, runs: int, all_runs: int, place: Any,
    row: Any,
) -> Any:  # fmt: skip
    """Copy the candidates of `look_around`; return how many of them are fluid."""
    wet = _copy(fluid, 0, begin[:runs], end[:runs], place, row, 0)
    _copy(solids, len(fluid.row), begin[runs:all_runs], end[runs:all_runs], place, row, wet)
    return wet


@njit(cache=True, error_model="numpy")
def _copy(
    cells: CellTable, first: int, begin: Any, end: Any, place: Any, row: Any, filled: int
) -> Any:
    """Copy runs of particles to place and row from `filled` on; return the end."""
    # Unsigned: numba checks every signed index for a count from the end.
    at: Any = np.uint64(filled)
    for run in range(len(begin)):
        for s in range(np.uint64(begin[run]), np.uint64(end[run])):
            place[0, at] = cells.place[0, s]
            place[1, at] = cells.place[1, s]
            place[2, at] = cells.place[2, s]
            row[at] = first + cells.row[s]
            at += np.uint64(1)
    return np.int64(at)


@njit(cache=True, error_model="numpy")
def measure(xs: Any, ys: Any, zs: Any, x: Any, y: Any, z: Any, squared: Any) -> None:
    """Write the squared distances, m², in a loop that is vectorized."""
    for c in range(len(xs)):
        dx, dy, dz = xs[c] - x, ys[c] - y, zs[c] - z
        squared[c] = dx * dx + dy * dy + dz * dz


@njit(cache=True, error_model="numpy")
def within(
    squared: Any, row: Any, count: int, mine: int, limit: Any, k: int, key: Any, spare: Any,
    bins: Any, start: Any,
) -> Any:  # fmt: skip
    """Write the sorted keys of the k nearest within the limit; return their number.

    A key holds the bits of the squared distance, which sort like the distance, then the row.
    """
    bits = squared.view(np.int32)
    found: Any = 0
    c, bound = 0, limit
    while c < count:
        before = found
        stop = min(count, c + len(key) - found)
        # Written always and counted if near, which avoids a branch.
        for candidate in range(np.uint64(c), np.uint64(stop)):
            key[np.uint64(found)] = candidate
            found += np.int64(squared[candidate] <= bound)
        near, found = found, before
        for i in range(before, near):
            index = np.uint64(key[i])
            key[np.uint64(found)] = (np.int64(bits[index]) << 32) | np.int64(row[index])
            found += np.int64(row[index] != mine)
        c = stop
        if c < count and found > k:
            _order(key, found, limit, spare, bins, start)
            found = k
            bound = np.int32(key[k - 1] >> 32).view(np.float32)
    _order(key, found, limit, spare, bins, start)
    return min(found, k)


@njit(cache=True, error_model="numpy")
def _order(key: Any, count: int, limit: Any, spare: Any, bins: Any, start: Any) -> None:
    """Sort the first `count` keys by a bucket sort over distance, then by insertion."""
    scale = np.float32(BINS) / (limit + np.float32(1e-30))
    start[:] = 0
    for i in range(count):
        squared = np.int32(key[i] >> 32).view(np.float32)
        # Unsigned, so that NaN goes to the highest bin.
        bins[i] = min(np.uint32(np.int32(squared * scale)), np.uint32(BINS - 1))
        start[np.uint32(bins[i])] += 1
    filled = np.int32(0)
    for b in range(BINS):
        number, start[b] = start[b], filled
        filled += number
    for i in range(count):
        mine = np.uint32(bins[i])
        spare[np.uint32(start[mine])] = key[i]
        start[mine] += 1
    highest = np.int64(-1)
    for i in range(count):
        value = spare[i]
        if value > highest:
            key[i] = highest = value
            continue
        j = i
        while j > 0 and key[j - 1] > value:
            key[j] = key[j - 1]
            j -= 1
        key[j] = value


@njit(cache=True, error_model="numpy")
def list_near(squared: Any, candidates: int, limit: Any, near: Any) -> Any:
    """Write the candidates within the limit to `near`; return their number."""
    found: Any = np.uint64(0)
    for candidate in range(np.uint64(candidates)):
        near[found] = candidate
        found += np.uint64(squared[candidate] <= limit)
    return np.int64(found)


@njit(cache=True, error_model="numpy")
def drop_farthest(squared: Any, row: Any, near: Any, found: int, k: int) -> Any:
    """Remove the farthest until k are left, of equally far ones the higher row; return how many."""
    while found > k:
        worst, far, highest = 0, squared[near[0]], row[near[0]]
        for i in range(1, found):
            distance, other = squared[near[i]], row[near[i]]
            if distance > far or (distance == far and other > highest):
                worst, far, highest = i, distance, other
        found -= 1
        near[worst] = near[found]
    return found


@njit(cache=True, error_model="numpy")
def keep_up_to(last: Any, squared: Any, row: Any, near: Any, found: int) -> Any:
    """Keep the neighbors whose key (see `within`) is at most `last`; return their number."""
    bits = squared.view(np.int32)
    kept = 0
    for i in range(found):
        index = near[i]
        near[kept] = index
        kept += (np.int64(bits[index]) << 32) | np.int64(row[index]) <= last
    return kept
