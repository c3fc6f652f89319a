"""Frames that no solver makes: all zero, or stored twice."""

from __future__ import annotations

from typing import Any, SupportsFloat

from numpy.typing import NDArray

#: Longest path of a particle within a frame, in radii, that rounding may hide.
_HIDDEN = 1e-2


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
