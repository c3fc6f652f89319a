"""Lists of neighbors in the rows of the particles, from lists in the order of a cell table."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray


def in_rows(
    row: NDArray[np.int32], offset: NDArray[np.int64], neighbor: NDArray[np.uint32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return neighbor (E,) and offset (N + 1,) of the particles before they were sorted.

    Args:
        row: (N,) row of each particle before sorting.
        offset: (N + 1,) first entry of each particle.
        neighbor: (E,) sorted rows.
    """
    count = len(row)
    offset_of_row = np.zeros(count + 1, np.int64)
    offset_of_row[1 + row] = np.diff(offset)
    np.cumsum(offset_of_row, out=offset_of_row)
    of_row = np.empty(len(neighbor), np.int64)
    _copy(row, offset, neighbor, offset_of_row, of_row)
    return of_row, offset_of_row


@njit(cache=True, parallel=True, error_model="numpy")
def _copy(row: Any, offset: Any, neighbor: Any, offset_of_row: Any, of_row: Any) -> None:
    for s in prange(len(row)):
        at = offset_of_row[row[s]]
        for e in range(offset[s], offset[s + 1]):
            of_row[at] = row[neighbor[e]]
            at += 1
