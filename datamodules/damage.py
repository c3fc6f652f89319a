"""Frames that no solver makes: all zero, or stored twice."""

from __future__ import annotations

from typing import Any, SupportsFloat

import h5py
from numpy.typing import NDArray

#: Longest path of a particle within a frame, in radii, that rounding may hide.
_HIDDEN = 1e-2

ZERO = "is all zero"
TWICE = "has the positions of the one before, though the fluid moves"


def is_zero(position: NDArray[Any]) -> bool:
    """Return whether the positions (N, 3) of a frame are all zero, those of a file not written."""
    return len(position) > 1 and not position.any()


def is_repeated(
    before: NDArray[Any], position: NDArray[Any], path: SupportsFloat, particle_radius: float
) -> bool:
    """Return whether a frame has the positions of another one although the fluid moves.

    Args:
        before: (N, 3) m, of the frame before.
        position: (N, 3) m.
        path: Path of the fastest particle within a frame, m.
        particle_radius: m.
    """
    return float(path) > _HIDDEN * particle_radius and not (before != position).any()


def damage_of(
    stored: h5py.Dataset,
    frame: int,
    position: NDArray[Any],
    path: SupportsFloat,
    particle_radius: float,
) -> str | None:
    """Return what is wrong with a frame of a data set, by itself and beside the one before.

    Of the frame before as little is read as tells the two apart: nothing, where compressed they
    differ in length.

    Args:
        stored: Positions (T, N, 3), m.
        frame: Number of the frame.
        position: Positions of the frame (N, 3), m.
        path: Path of the fastest particle within a frame, m.
        particle_radius: m.
    """
    if is_zero(position):
        return ZERO
    if frame == 0 or _lengths_differ(stored, frame):
        return None
    try:
        # Of data without compression the first particle tells nearly always.
        if (position[0] != stored[frame - 1, 0]).any():
            return None
        repeated = is_repeated(stored[frame - 1], position, path, particle_radius)
    except OSError:
        # The frame before is damaged, and another read names it.
        return None
    return TWICE if repeated else None


def _lengths_differ(stored: h5py.Dataset, frame: int) -> bool:
    """Return whether two neighboring frames, each a chunk, have other lengths on disk."""
    if stored.chunks is None or stored.chunks != (1, *stored.shape[1:]):
        return False
    sizes = {
        stored.id.get_chunk_info_by_coord((number, 0, 0)).size for number in (frame - 1, frame)
    }
    return len(sizes) == 2
