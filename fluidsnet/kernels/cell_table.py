"""Cell table: particles sorted into cells by a counting sort."""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.kernels.threads import set_threads
from fluidsnet.particles import Particles

# Cells are wider than the support radius, so that rounding puts no neighbor two cells away.
_WIDTH = 1.00001
# Bound of cells per particle, and so of memory where particles fly far apart.
_CELLS_PER_PARTICLE = 4


class CellTable(NamedTuple):
    """P particles in the order of their cells; each frame has cells of its own.

    Cells repeat periodically along an axis. The period covers all particles where memory
    allows, and is shorter where particles flew far apart; distant particles then share a
    cell, but near ones are always in the same or in adjacent cells.

    Attributes:
        start: (C + 2,) int32, cell c has the particles start[c] to start[c + 1]; after the C
            cells comes one, never read, for positions that are not finite.
        row: (P,) int32 row of each particle before sorting.
        place: (3, P) float32 position, m.
        frame: (P,) int32.
        size: (3,) int64 period of the cells along x, y, z; at least 3, so that the two
            neighbors of a cell along an axis differ.
        density: Cells per m.
    """

    start: NDArray[np.int32]
    row: NDArray[np.int32]
    place: NDArray[np.float32]
    frame: NDArray[np.int32]
    size: NDArray[np.int64]
    density: float


@final
class CellTables:
    """Sort the fluid and solid particles of a batch; solids at rest are sorted once."""

    def __init__(self) -> None:
        self._solids: TensorCache[CellTable] = TensorCache()

    def __call__(self, particles: Particles) -> tuple[CellTable, CellTable]:
        """Return the tables of fluid and solids, with cells as wide as the support radius."""
        set_threads(len(particles))
        radius = particles.scene.support_radius
        extent = [max(edges) for edges in zip(*particles.scene.edges, strict=True)]

        def sort(position: Tensor, frame: Tensor) -> CellTable:
            # At a radius of zero only particles at the same place are neighbors.
            width = max(_WIDTH * radius, 1e-30)
            return _table(position, frame, particles.frames, width, extent)

        fluid = sort(particles.position, particles.frame)
        solids = self._solids.get(
            (particles.solid_position, particles.solid_frame),
            (particles.frames, radius, *extent),
            sort,
        )
        return fluid, solids


def _table(
    position: Tensor, frame: Tensor, frames: int, width: float, extent: list[float]
) -> CellTable:
    """Sort P particles into cells of a width in m; the domain's extent affects the speed alone."""
    places = position.detach().cpu().float().contiguous().numpy()
    in_frame = frame.cpu().contiguous().numpy()
    room = _CELLS_PER_PARTICLE * len(places) / max(frames, 1)
    # One more than occupied, so that the ends of the occupied box are not adjacent.
    spans = (_spans(places, 1.0 / width) + 1.0).tolist()
    if np.prod(spans) > room:
        # The domain's own size, so that a few particles far out do not coarsen the rest.
        spans = [
            min(span, max(edge / width, 0.0) + 2.0)
            for span, edge in zip(spans, extent, strict=True)
        ]
    size = np.empty(3, np.int64)
    # The short axes first; the long ones share the rest of the memory.
    for left, axis in zip((3, 2, 1), sorted(range(3), key=spans.__getitem__), strict=True):
        fair = max(room, 1.0) ** (1 / left)
        # Odd, because positions far out are multiples of a power of two.
        size[axis] = max(3, int(spans[axis]) if spans[axis] <= fair else int(fair) | 1)
        room /= size[axis]
    start, row, place, of_row = _sort(places, in_frame, frames, 1.0 / width, size)
    return CellTable(start, row, place, of_row, size, 1.0 / width)


@njit(cache=True, error_model="numpy")
def around(cells: CellTable, frame: int, cell: Any, begin: Any, end: Any, found: int) -> Any:
    """Append the runs of particles in the 27 cells around a cell; return the number of runs.

    Args:
        cells: Table of the particles.
        frame: Frame of the cell.
        cell: (3,) coordinates from `cell_of`.
        begin: (54,) first particle of each run; written from `found` on.
        end: (54,) end of each run.
        found: Number of runs before; 27 more at most are found.
    """
    start, size = cells.start, cells.size
    x, y, z = _slot(cell[0], size[0]), _slot(cell[1], size[1]), _slot(cell[2], size[2])
    for dz in range(-1, 2):
        plane = (frame * size[2] + _beside(z + dz, size[2])) * size[1]
        for dy in range(-1, 2):
            line = (plane + _beside(y + dy, size[1])) * size[0]
            if 1 <= x < size[0] - 1:
                # Three cells along x are contiguous.
                begin[found], end[found] = start[line + x - 1], start[line + x + 2]
                found += end[found] > begin[found]
            else:
                for dx in range(-1, 2):
                    slot = line + _beside(x + dx, size[0])
                    begin[found], end[found] = start[slot], start[slot + 1]
                    found += end[found] > begin[found]
    return found


@njit(cache=True, error_model="numpy")
def cell_of(coordinate: float, density: float) -> Any:
    """Return the cell of a coordinate in m, as a whole float64."""
    return np.floor(np.float64(coordinate) * density)


@njit(cache=True, error_model="numpy")
def is_finite(x: float, y: float, z: float) -> Any:
    """Return whether a position is finite."""
    return np.isfinite(x) and np.isfinite(y) and np.isfinite(z)


@njit(cache=True, error_model="numpy")
def _slot(cell: float, size: int) -> Any:
    """Return a cell modulo the period; clipped, since float64 has gaps beyond 2⁵³."""
    return int(min(max(cell - size * np.floor(cell / size), 0.0), size - 1.0))


@njit(cache=True, error_model="numpy")
def _beside(slot: int, size: int) -> Any:
    """Return a slot at most one beyond either end, wrapped around."""
    if slot < 0:
        return slot + size
    return slot - size if slot >= size else slot


@njit(cache=True, error_model="numpy")
def _spans(place: Any, density: float) -> Any:
    """Return the (3,) float64 extent of the finite positions (P, 3), in cells."""
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
    """Sort particles by cell (counting sort); return the arrays of a `CellTable`."""
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
    # Counts are stored two places late: start[c + 1] is the beginning of cell c, and its end
    # once the cell is filled.
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
