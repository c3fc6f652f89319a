"""The k nearest of one cell's particles among the candidates around it, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fluidsnet.neighbors.cells import CellTable, around, cell_of

#: Particles a thread takes at a time.
BLOCK = 1024
#: Into how many ranges of distance neighbors are put before they are sorted.
BINS = 64
#: Particles beyond the k nearest that are best dropped one by one; for more, all are sorted.
DROPPED = 8
#: The part of a key that is a row.
ROW = 0x7FFFFFFF


@njit(cache=True, error_model="numpy")
def enters(cells: CellTable, s: int, cell: Any) -> Any:
    """Whether a particle is in another cell than the one in `cell`; writes its own there.

    Args:
        cells: the particle is one of.
        s: its place among them.
        cell: (4,) float64, along x, y, z, and the frame; NaN before the first particle.
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
    """Writes the runs of candidates in and around a cell, the fluid's first.

    Args:
        fluid: particles.
        solids: particles.
        cell: (4,) as `enters` writes it.
        begin: (54,) of each run.
        end: (54,) of the same.

    Returns:
        Runs of fluid particles, and runs there are in all.
    """
    runs = around(fluid, int(cell[3]), cell, begin, end, 0)
    return runs, around(solids, int(cell[3]), cell, begin, end, runs)


@njit(cache=True, error_model="numpy")
def collect(
    fluid: CellTable, solids: CellTable, begin: Any, end: Any, runs: int, all_runs: int, place: Any,
    row: Any,
) -> Any:  # fmt: skip
    """Copies the runs of `look_around` side by side; returns how many of them are fluid."""
    wet = _copy(fluid, 0, begin[:runs], end[:runs], place, row, 0)
    _copy(solids, len(fluid.row), begin[runs:all_runs], end[runs:all_runs], place, row, wet)
    return wet


@njit(cache=True, error_model="numpy")
def _copy(
    cells: CellTable, first: int, begin: Any, end: Any, place: Any, row: Any, filled: int
) -> Any:
    """Copies runs of particles side by side, from `filled` on; returns where they end."""
    # Unsigned, since numba asks of every signed index whether it counts from the end.
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
    """Writes the squared distances; a loop so plain that it is vectorised."""
    for c in range(len(xs)):
        dx, dy, dz = xs[c] - x, ys[c] - y, zs[c] - z
        squared[c] = dx * dx + dy * dy + dz * dz


@njit(cache=True, error_model="numpy")
def within(
    squared: Any, row: Any, count: int, mine: int, limit: Any, k: int, key: Any, spare: Any,
    bins: Any, start: Any,
) -> Any:  # fmt: skip
    """Writes the keys of the k nearest within the limit, sorted; returns how many.

    A key is the bits of the squared distance, which sort as it does, then the row.
    """
    bits = squared.view(np.int32)
    found: Any = 0
    c, bound = 0, limit
    while c < count:
        before = found
        stop = min(count, c + len(key) - found)
        # Written always and counted if near: no branch to guess wrong.
        for candidate in range(np.uint64(c), np.uint64(stop)):
            key[np.uint64(found)] = candidate
            found += np.int64(squared[candidate] <= bound)
        near, found = found, before
        for i in range(before, near):
            one = np.uint64(key[i])
            key[np.uint64(found)] = (np.int64(bits[one]) << 32) | np.int64(row[one])
            found += np.int64(row[one] != mine)
        c = stop
        if c < count and found > k:
            _order(key, found, limit, spare, bins, start)
            found = k
            bound = np.int32(key[k - 1] >> 32).view(np.float32)
    _order(key, found, limit, spare, bins, start)
    return min(found, k)


@njit(cache=True, error_model="numpy")
def _order(key: Any, count: int, limit: Any, spare: Any, bins: Any, start: Any) -> None:
    """Sorts the first `count` keys: roughly, into bins of distance, then by insertion."""
    scale = np.float32(BINS) / (limit + np.float32(1e-30))
    start[:] = 0
    for i in range(count):
        squared = np.int32(key[i] >> 32).view(np.float32)
        # Unsigned, since what is none becomes the highest.
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
    """Writes the candidates within the limit; returns how many."""
    found: Any = np.uint64(0)
    for candidate in range(np.uint64(candidates)):
        near[found] = candidate
        found += np.uint64(squared[candidate] <= limit)
    return np.int64(found)


@njit(cache=True, error_model="numpy")
def drop_farthest(squared: Any, row: Any, near: Any, found: int, k: int) -> Any:
    """Drops the farthest, of the equally far the highest row, until k are left."""
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
    """Keeps those whose key, as in `within`, is at most the last; returns how many."""
    bits = squared.view(np.int32)
    kept = 0
    for i in range(found):
        one = near[i]
        near[kept] = one
        kept += (np.int64(bits[one]) << 32) | np.int64(row[one]) <= last
    return kept
