"""Exact neighbors on the CPU: a cell list, compiled, on every core."""

from __future__ import annotations

from typing import Any, final

import numpy as np
import torch
from numba import config, njit, prange, set_num_threads
from torch import Tensor

from fluidsnet.neighbors.cells import Cells, around, cell_of, is_finite, sort_into_cells
from fluidsnet.neighbors.kept import Kept
from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles

# A hair wider than the support radius, so that no rounding puts a neighbor two cells away.
_WIDTH = 1.00001
# Particles that are worth a thread.
_A_THREAD = 4096
# Particles a thread takes at a time.
_BLOCK = 1024
# Into how many ranges of distance neighbors are put before they are sorted.
_BINS = 64
_ROW = 0x7FFFFFFF


@final
class CellListCPU(NeighborSearch):
    """A cell list in numba: exact, of linear cost, on as many threads as torch has.

    Particles are sorted into cells as wide as the support radius, and each looks through
    the 27 around it. Fluid and solids have their own cells; while the solids rest, theirs
    are kept from call to call. Memory grows with the particles alone, wherever they are.
    The first call ever compiles, which takes some 15 s; the result is kept on disk.

    Distances are compared in float32. Particles on another device are copied to and fro.

    Args:
        k: the most neighbors a particle has.
    """

    def __init__(self, k: int = 32) -> None:
        super().__init__(k)
        self._solids: Kept[Cells] = Kept()

    def __call__(self, particles: Particles) -> Neighbors:
        most: int = config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
        # For few, threads that wait for each other cost more than they save.
        set_num_threads(min(torch.get_num_threads(), most, 1 + len(particles) // _A_THREAD))
        radius = particles.scene.support_radius
        extent: list[float] = particles.scene.extent.tolist()

        def sort(position: Tensor, frame: Tensor) -> Cells:
            # A radius of zero is allowed: then only who shares a place is a neighbor.
            width = max(_WIDTH * radius, 1e-30)
            return sort_into_cells(position, frame, particles.frames, width, extent)

        fluid = sort(particles.position, particles.frame)
        solids = self._solids.get(
            (particles.solid_position, particles.solid_frame),
            (particles.frames, radius, *extent),
            sort,
        )
        count = len(particles)
        # NumPy asks for huge pages where numba would not, which halves the time of writing.
        nearest = np.empty((count, self.k), np.int32)
        offset = np.zeros(count + 1, np.int64)
        _search(fluid, solids, np.float32(radius**2), nearest, offset[1:])
        np.cumsum(offset, out=offset)
        particle, neighbor = np.empty(offset[-1], np.int64), np.empty(offset[-1], np.int64)
        _flatten(nearest, offset, particle, neighbor)
        device = particles.position.device
        return Neighbors(
            torch.from_numpy(particle).to(device),
            torch.from_numpy(neighbor).to(device),
            torch.from_numpy(offset).to(device),
        )


@njit(cache=True, parallel=True, error_model="numpy")
def _search(fluid: Cells, solids: Cells, limit: Any, nearest: Any, number: Any) -> None:
    """Fills in the rows of the nearest (N, k), and how many there are (N,), by row."""
    count = len(fluid.row)
    for block in prange((count + _BLOCK - 1) // _BLOCK):
        cell, last_cell, last_frame = np.empty(3), np.full(3, np.nan), -1
        begin, end = np.empty(54, np.int64), np.empty(54, np.int64)
        place, row = np.empty((3, 1024), np.float32), np.empty(1024, np.int32)
        squared = np.empty(1024, np.float32)
        # Room for some more than k: what does not fit is thinned to the k nearest.
        key = np.empty(2 * nearest.shape[1] + 512, np.int64)
        spare, bins = np.empty(len(key), np.int64), np.empty(len(key), np.int32)
        start = np.empty(_BINS, np.int32)
        candidates = 0
        for s in range(block * _BLOCK, min(count, (block + 1) * _BLOCK)):
            x, y, z = fluid.place[0, s], fluid.place[1, s], fluid.place[2, s]
            if not is_finite(x, y, z):
                number[fluid.row[s]] = 0
                continue
            cell[0] = cell_of(x, fluid.density)
            cell[1] = cell_of(y, fluid.density)
            cell[2] = cell_of(z, fluid.density)
            frame = fluid.frame[s]
            if (
                frame != last_frame
                or cell[0] != last_cell[0]
                or cell[1] != last_cell[1]
                or cell[2] != last_cell[2]
            ):
                # One cell's particles share their candidates.
                last_cell[:], last_frame = cell, frame
                runs = around(fluid, frame, cell, begin, end, 0)
                all_runs = around(solids, frame, cell, begin, end, runs)
                candidates = (end[:all_runs] - begin[:all_runs]).sum()
                if candidates > len(row):
                    place = np.empty((3, 2 * candidates), np.float32)
                    row = np.empty(2 * candidates, np.int32)
                    squared = np.empty(2 * candidates, np.float32)
                filled = _collect(fluid, 0, begin[:runs], end[:runs], place, row, 0)
                _collect(
                    solids, count, begin[runs:all_runs], end[runs:all_runs], place, row, filled
                )
            _measure(place[0, :candidates], place[1], place[2], x, y, z, squared)
            mine = fluid.row[s]
            found = _within(
                squared, row, candidates, mine, limit, nearest.shape[1], key, spare, bins, start
            )
            number[mine] = found
            for i in range(found):
                nearest[mine, i] = key[i] & _ROW


@njit(cache=True, error_model="numpy")
def _collect(
    cells: Cells, first: int, begin: Any, end: Any, place: Any, row: Any, filled: int
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
def _measure(xs: Any, ys: Any, zs: Any, x: Any, y: Any, z: Any, squared: Any) -> None:
    """Writes the squared distances; a loop so plain that it is vectorised."""
    for c in range(len(xs)):
        dx, dy, dz = xs[c] - x, ys[c] - y, zs[c] - z
        squared[c] = dx * dx + dy * dy + dz * dz


@njit(cache=True, error_model="numpy")
def _within(
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
    scale = np.float32(_BINS) / (limit + np.float32(1e-30))
    start[:] = 0
    for i in range(count):
        squared = np.int32(key[i] >> 32).view(np.float32)
        # Unsigned, since what is none becomes the highest.
        bins[i] = min(np.uint32(np.int32(squared * scale)), np.uint32(_BINS - 1))
        start[np.uint32(bins[i])] += 1
    filled = np.int32(0)
    for b in range(_BINS):
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


@njit(cache=True, parallel=True, error_model="numpy")
def _flatten(nearest: Any, offset: Any, particle: Any, neighbor: Any) -> None:
    """Edges (E,) from the rows of the nearest (N, k) and the offsets (N + 1,)."""
    for i in prange(len(nearest)):
        for edge in range(offset[i], offset[i + 1]):
            particle[edge] = i
            neighbor[edge] = nearest[i, edge - offset[i]]
