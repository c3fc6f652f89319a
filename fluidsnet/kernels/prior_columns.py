"""Kernel of the columns that describe a state by its density and its walls."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from fluidsnet.kernels.moments import basis
from fluidsnet.kernels.sph_sums import CHUNK, slope, spline


@njit(cache=True, parallel=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def density_and_walls(
    place: Any, offset: Any, neighbor: Any, wall_offset: Any, wall: Any, wall_place: Any,
    wall_volume: Any, radius: float, height: float, volume: float, out: Any,
) -> None:  # fmt: skip
    """Write ρ/ρ₀, its gradient times the support radius, and ten moments of the walls, (N, 14).

    Moments are those of `neighbor_moments`, of the walls' volumes over that of a fluid particle.
    """
    top, inverse, own = np.float32(height), np.float32(1.0 / radius), np.float32(volume)
    least = np.float32(1e-8 * radius)
    count = len(place)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        weights, other = np.zeros((10, 1), np.float32), np.empty(3, np.float32)
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            x, y, z = place[i, 0], place[i, 1], place[i, 2]
            a = b = c = np.float32(0.0)
            total = own * top * spline(np.float32(0.0))
            for e in range(offset[i], offset[i + 1]):
                j = neighbor[e]
                dx, dy, dz = x - place[j, 0], y - place[j, 1], z - place[j, 2]
                distance = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)) + least
                q = distance * inverse
                total += own * top * spline(q)
                factor = own * top * slope(q) / distance
                a += factor * dx
                b += factor * dy
                c += factor * dz
            out[i, 4:14] = 0
            for e in range(wall_offset[i], wall_offset[i + 1]):
                j = wall[e]
                for axis in range(3):
                    other[axis] = wall_place[axis, j]
                dx, dy, dz = x - other[0], y - other[1], z - other[2]
                distance = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)) + least
                q = distance * inverse
                weight = wall_volume[j]
                total += weight * top * spline(q)
                factor = weight * top * slope(q) / distance
                a += factor * dx
                b += factor * dy
                c += factor * dz
                basis(place[i], other, inverse, weights, 0)
                for k in range(10):
                    out[i, 4 + k] += weight / own * weights[k, 0]
            out[i, 0], out[i, 1], out[i, 2], out[i, 3] = total, a, b, c
