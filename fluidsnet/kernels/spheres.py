"""Depth buffer of spheres, for pictures of particles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def nearest_spheres(
    center: Floats, size: Floats, radius: float, width: int, height: int
) -> NDArray[np.int64]:
    """Return the sphere that is seen in each pixel of a picture, (height, width); -1 for none.

    Args:
        center: (N, 3) column and row, pixels, and distance from the eye, m.
        size: (N,) radius in the picture, pixels.
        radius: Radius of a sphere, m.
        width: Pixels.
        height: Pixels.
    """
    owner = np.full((height, width), -1)
    _draw(center, size, radius, np.full((height, width), np.inf), owner)
    return owner


@njit(cache=True)
def _draw(center: Any, size: Any, radius: Any, nearest: Any, owner: Any) -> None:
    height, width = owner.shape
    for sphere in range(len(center)):
        x, y, depth = center[sphere]
        reach = size[sphere]
        for row in range(max(int(y - reach), 0), min(int(y + reach) + 1, height)):
            down = (row + 0.5 - y) / reach
            for column in range(max(int(x - reach), 0), min(int(x + reach) + 1, width)):
                across = (column + 0.5 - x) / reach
                squared = down * down + across * across
                if squared < 1:
                    surface = depth - radius * np.sqrt(1 - squared)
                    if surface < nearest[row, column]:
                        nearest[row, column] = surface
                        owner[row, column] = sphere
