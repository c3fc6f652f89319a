"""Exact neighbors on the CPU: a cell list, compiled, on every core."""

from __future__ import annotations

from typing import Any, final

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.neighbors.cells import CellTable, is_finite, sort_into_cells
from fluidsnet.neighbors.nearest import (
    BINS,
    BLOCK,
    ROW,
    collect,
    enters,
    look_around,
    measure,
    within,
)
from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.neighbors.threads import take_threads
from fluidsnet.particles import Particles

# A hair wider than the support radius, so that no rounding puts a neighbor two cells away.
_WIDTH = 1.00001


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
        self._solids: TensorCache[CellTable] = TensorCache()

    def __call__(self, particles: Particles) -> Neighbors:
        fluid, solids = self.cells(particles)
        count = len(particles)
        # NumPy asks for huge pages where numba would not, which halves the time of writing.
        nearest = np.empty((count, self.k), np.int32)
        offset = np.zeros(count + 1, np.int64)
        limit = np.float32(particles.scene.support_radius**2)
        _search(fluid, solids, limit, nearest, offset[1:])
        np.cumsum(offset, out=offset)
        particle, neighbor = np.empty(offset[-1], np.int64), np.empty(offset[-1], np.int64)
        _flatten(nearest, offset, particle, neighbor)
        device = particles.position.device
        return Neighbors(
            torch.from_numpy(particle).to(device),
            torch.from_numpy(neighbor).to(device),
            torch.from_numpy(offset).to(device),
        )

    def cells(self, particles: Particles) -> tuple[CellTable, CellTable]:
        take_threads(len(particles))
        radius = particles.scene.support_radius
        extent: list[float] = particles.scene.extent.tolist()

        def sort(position: Tensor, frame: Tensor) -> CellTable:
            # A radius of zero is allowed: then only who shares a place is a neighbor.
            width = max(_WIDTH * radius, 1e-30)
            return sort_into_cells(position, frame, particles.frames, width, extent)

        fluid = sort(particles.position, particles.frame)
        solids = self._solids.get(
            (particles.solid_position, particles.solid_frame),
            (particles.frames, radius, *extent),
            sort,
        )
        return fluid, solids


@njit(cache=True, parallel=True, error_model="numpy")
def _search(fluid: CellTable, solids: CellTable, limit: Any, nearest: Any, number: Any) -> None:
    """Fills in the rows of the nearest (N, k), and how many there are (N,), by row."""
    count = len(fluid.row)
    for block in prange((count + BLOCK - 1) // BLOCK):
        cell, begin, end = np.full(4, np.nan), np.empty(54, np.int64), np.empty(54, np.int64)
        place, row = np.empty((3, 1024), np.float32), np.empty(1024, np.int32)
        squared = np.empty(1024, np.float32)
        # Room for some more than k: what does not fit is thinned to the k nearest.
        key = np.empty(2 * nearest.shape[1] + 512, np.int64)
        spare, bins = np.empty(len(key), np.int64), np.empty(len(key), np.int32)
        start = np.empty(BINS, np.int32)
        candidates = 0
        for s in range(block * BLOCK, min(count, (block + 1) * BLOCK)):
            x, y, z = fluid.place[0, s], fluid.place[1, s], fluid.place[2, s]
            if not is_finite(x, y, z):
                number[fluid.row[s]] = 0
                continue
            if enters(fluid, s, cell):
                # One cell's particles share their candidates.
                runs, all_runs = look_around(fluid, solids, cell, begin, end)
                candidates = (end[:all_runs] - begin[:all_runs]).sum()
                if candidates > len(row):
                    place = np.empty((3, 2 * candidates), np.float32)
                    row = np.empty(2 * candidates, np.int32)
                    squared = np.empty(2 * candidates, np.float32)
                collect(fluid, solids, begin, end, runs, all_runs, place, row)
            measure(place[0, :candidates], place[1], place[2], x, y, z, squared)
            mine = fluid.row[s]
            found = within(
                squared, row, candidates, mine, limit, nearest.shape[1], key, spare, bins, start
            )
            number[mine] = found
            for i in range(found):
                nearest[mine, i] = key[i] & ROW


@njit(cache=True, parallel=True, error_model="numpy")
def _flatten(nearest: Any, offset: Any, particle: Any, neighbor: Any) -> None:
    """Edges (E,) from the rows of the nearest (N, k) and the offsets (N + 1,)."""
    for i in prange(len(nearest)):
        for edge in range(offset[i], offset[i + 1]):
            particle[edge] = i
            neighbor[edge] = nearest[i, edge - offset[i]]
