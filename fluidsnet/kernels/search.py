"""Search for the k nearest neighbors in cell tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from fluidsnet.kernels import nearest
from fluidsnet.kernels.cell_table import CellTable, is_finite


def nearest_neighbors(
    fluid: CellTable, solids: CellTable, radius: float, k: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Return particle, neighbor (E,) and offset (N + 1,) of the edges, the nearest first.

    Args:
        fluid: N particles whose neighbors are searched.
        solids: Further candidates; their rows follow those of the fluid.
        radius: Neighbor cutoff, m.
        k: Maximum number of neighbors of a particle.
    """
    count = len(fluid.row)
    # NumPy allocates huge pages and numba does not, which halves the time of writing.
    rows = np.empty((count, k), np.int32)
    offset = np.zeros(count + 1, np.int64)
    _search(fluid, solids, np.float32(radius**2), rows, offset[1:])
    np.cumsum(offset, out=offset)
    particle, neighbor = np.empty(offset[-1], np.int64), np.empty(offset[-1], np.int64)
    _flatten(rows, offset, particle, neighbor)
    return torch.from_numpy(particle), torch.from_numpy(neighbor), torch.from_numpy(offset)


@njit(cache=True, parallel=True, error_model="numpy")
def _search(fluid: CellTable, solids: CellTable, limit: Any, rows: Any, number: Any) -> None:
    """Write the rows of the nearest (N, k) and their number (N,) for each particle."""
    count = len(fluid.row)
    for block in prange((count + nearest.BLOCK - 1) // nearest.BLOCK):
        cell, begin, end = np.full(4, np.nan), np.empty(54, np.int64), np.empty(54, np.int64)
        place, row = np.empty((3, 1024), np.float32), np.empty(1024, np.int32)
        squared = np.empty(1024, np.float32)
        # Holds more than k; where it is full, only the k nearest are kept.
        key = np.empty(2 * rows.shape[1] + 512, np.int64)
        spare, bins = np.empty(len(key), np.int64), np.empty(len(key), np.int32)
        start = np.empty(nearest.BINS, np.int32)
        candidates = 0
        for s in range(block * nearest.BLOCK, min(count, (block + 1) * nearest.BLOCK)):
            x, y, z = fluid.place[0, s], fluid.place[1, s], fluid.place[2, s]
            if not is_finite(x, y, z):
                number[fluid.row[s]] = 0
                continue
            if nearest.enters(fluid, s, cell):
                # The particles of a cell have the same candidates.
                runs, all_runs = nearest.look_around(fluid, solids, cell, begin, end)
                candidates = (end[:all_runs] - begin[:all_runs]).sum()
                if candidates > len(row):
                    place = np.empty((3, 2 * candidates), np.float32)
                    row = np.empty(2 * candidates, np.int32)
                    squared = np.empty(2 * candidates, np.float32)
                nearest.collect(fluid, solids, begin, end, runs, all_runs, place, row)
            nearest.measure(place[0, :candidates], place[1], place[2], x, y, z, squared)
            mine = fluid.row[s]
            found = nearest.within(
                squared, row, candidates, mine, limit, rows.shape[1], key, spare, bins, start
            )
            number[mine] = found
            for i in range(found):
                rows[mine, i] = key[i] & nearest.ROW


@njit(cache=True, parallel=True, error_model="numpy")
def _flatten(rows: Any, offset: Any, particle: Any, neighbor: Any) -> None:
    """Write the edges (E,) from the rows of the nearest (N, k) and the offsets (N + 1,)."""
    for i in prange(len(rows)):
        for edge in range(offset[i], offset[i + 1]):
            particle[edge] = i
            neighbor[edge] = rows[i, edge - offset[i]]
