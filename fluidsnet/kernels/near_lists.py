"""Lists of all particles within the support radius, in the order of the cell tables."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fluidsnet.kernels import nearest
from fluidsnet.kernels.cell_table import CellTable, is_finite

# Particles per block of a thread.
_BLOCK = 256


class NearLists(NamedTuple):
    """All particles within the support radius of each fluid particle, itself excluded.

    Rows are those of the cell tables. If j is in the list of i, then i is in that of j.

    Attributes:
        offset: (N + 1,) int64, particle i has the entries offset[i] to offset[i + 1].
        neighbor: (E,) uint32, rows of fluid particles.
        wall_offset: (N + 1,) int64, as `offset`.
        wall: (W,) uint32, rows of solid particles.
    """

    offset: NDArray[np.int64]
    neighbor: NDArray[np.uint32]
    wall_offset: NDArray[np.int64]
    wall: NDArray[np.uint32]


def near_lists(fluid: CellTable, solids: CellTable, radius: float) -> NearLists:
    """Return the lists of the particles of a table; those at no finite place have none."""
    count = len(fluid.row)
    offset, wall_offset = np.zeros(count + 1, np.int64), np.zeros(count + 1, np.int64)
    limit = np.float32(radius**2)
    _count(fluid, solids, limit, offset[1:], wall_offset[1:])
    np.cumsum(offset, out=offset)
    np.cumsum(wall_offset, out=wall_offset)
    neighbor, wall = np.empty(offset[-1], np.uint32), np.empty(wall_offset[-1], np.uint32)
    _fill(fluid, solids, limit, offset, neighbor, wall_offset, wall)
    return NearLists(offset, neighbor, wall_offset, wall)


@njit(cache=True, parallel=True, error_model="numpy")
def _count(fluid: CellTable, solids: CellTable, limit: Any, number: Any, walls: Any) -> None:
    """Write the number of fluid and solid neighbors of each particle, (N,) each."""
    count = len(fluid.row)
    for block in prange((count + _BLOCK - 1) // _BLOCK):
        cell, begin, end = np.full(4, np.nan), np.empty(54, np.int64), np.empty(54, np.int64)
        place, row = np.empty((3, 1024), np.float32), np.empty(1024, np.uint32)
        squared = np.empty(1024, np.float32)
        wet = total = 0
        for s in range(block * _BLOCK, min(count, (block + 1) * _BLOCK)):
            x, y, z = fluid.place[0, s], fluid.place[1, s], fluid.place[2, s]
            if not is_finite(x, y, z):
                number[s] = walls[s] = 0
                continue
            if nearest.enters(fluid, s, cell):
                runs, all_runs = nearest.look_around(fluid, solids, cell, begin, end)
                candidates = (end[:all_runs] - begin[:all_runs]).sum()
                if candidates > len(row):
                    place = np.empty((3, 2 * candidates), np.float32)
                    row = np.empty(2 * candidates, np.uint32)
                    squared = np.empty(2 * candidates, np.float32)
                wet, total = _collect(fluid, solids, begin, end, runs, all_runs, place, row)
            nearest.measure(place[0, :total], place[1], place[2], x, y, z, squared)
            number[s] = _number_within(squared[:wet], limit) - 1
            walls[s] = _number_within(squared[wet:total], limit)


@njit(cache=True, parallel=True, error_model="numpy")
def _fill(
    fluid: CellTable, solids: CellTable, limit: Any, offset: Any, neighbor: Any, wall_offset: Any,
    wall: Any,
) -> None:  # fmt: skip
    """Write the neighbors of each particle."""
    count = len(fluid.row)
    for block in prange((count + _BLOCK - 1) // _BLOCK):
        cell, begin, end = np.full(4, np.nan), np.empty(54, np.int64), np.empty(54, np.int64)
        place, row = np.empty((3, 1024), np.float32), np.empty(1024, np.uint32)
        squared, found = np.empty(1024, np.float32), np.empty(1024, np.uint32)
        wet = total = 0
        for s in range(block * _BLOCK, min(count, (block + 1) * _BLOCK)):
            x, y, z = fluid.place[0, s], fluid.place[1, s], fluid.place[2, s]
            if not is_finite(x, y, z):
                continue
            if nearest.enters(fluid, s, cell):
                runs, all_runs = nearest.look_around(fluid, solids, cell, begin, end)
                candidates = (end[:all_runs] - begin[:all_runs]).sum()
                if candidates > len(row):
                    place = np.empty((3, 2 * candidates), np.float32)
                    row, found = (
                        np.empty(2 * candidates, np.uint32),
                        np.empty(2 * candidates, np.uint32),
                    )
                    squared = np.empty(2 * candidates, np.float32)
                wet, total = _collect(fluid, solids, begin, end, runs, all_runs, place, row)
            nearest.measure(place[0, :total], place[1], place[2], x, y, z, squared)
            at = offset[s]
            for entry in range(_within(squared[:wet], row, limit, found)):
                if found[entry] != s:
                    neighbor[at] = found[entry]
                    at += 1
            at = wall_offset[s]
            for entry in range(_within(squared[wet:total], row[wet:], limit, found)):
                wall[at + entry] = found[entry]


@njit(cache=True, error_model="numpy")
def _collect(
    fluid: CellTable, solids: CellTable, begin: Any, end: Any, runs: int, all_runs: int,
    place: Any, row: Any,
) -> Any:  # fmt: skip
    """Copy the candidates of `look_around`; return the number of fluid ones and of all."""
    wet = _copy(fluid, begin[:runs], end[:runs], place, row, 0)
    return wet, _copy(solids, begin[runs:all_runs], end[runs:all_runs], place, row, wet)


@njit(cache=True, error_model="numpy")
def _copy(cells: CellTable, begin: Any, end: Any, place: Any, row: Any, filled: int) -> Any:
    """Copy runs of particles to place and row from `filled` on; return the end."""
    at: Any = np.uint64(filled)
    for run in range(len(begin)):
        for s in range(np.uint64(begin[run]), np.uint64(end[run])):
            place[0, at] = cells.place[0, s]
            place[1, at] = cells.place[1, s]
            place[2, at] = cells.place[2, s]
            row[at] = s
            at += np.uint64(1)
    return np.int64(at)


@njit(cache=True, error_model="numpy")
def _number_within(squared: Any, limit: Any) -> Any:
    """Return the number of squared distances up to a limit."""
    number = np.int32(0)
    for c in range(len(squared)):
        number += np.int32(squared[c] <= limit)
    return np.int64(number)


@njit(cache=True, error_model="numpy")
def _within(squared: Any, row: Any, limit: Any, found: Any) -> Any:
    """Write the rows of squared distances up to a limit; return their number."""
    number: Any = np.uint64(0)
    for c in range(np.uint64(len(squared))):
        # Written always and counted if near, which avoids a branch.
        found[number] = row[c]
        number += np.uint64(squared[c] <= limit)
    return np.int64(number)
