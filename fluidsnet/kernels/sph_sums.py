"""SPH sums of the coarse pressure step over lists of neighbors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from fluidsnet.kernels.near_lists import NearLists

#: Particles per task of a thread.
CHUNK = 64
#: Order of sums may change; values that are not finite stay so.
FAST = {"contract", "reassoc", "nsz", "arcp"}
#: Share of the inverse squared support radius that is added to the diagonal of the pressure
#: system, which bounds the pressure of a particle with few neighbors.
REGULARIZATION = 0.01


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def solid_volumes(place: Any, lists: NearLists, radius: float, height: float, volume: Any) -> None:
    """Write the volumes (M,) of solids, m³, 1 / Σ W over the solids around (Akinci et al. 2012)."""
    for i in prange(len(volume)):
        total = spline(np.float32(0.0))
        for e in range(lists.offset[i], lists.offset[i + 1]):
            j = lists.neighbor[e]
            x, y, z = (
                place[0, i] - place[0, j],
                place[1, i] - place[1, j],
                place[2, i] - place[2, j],
            )
            total += spline(np.float32(math.sqrt(x * x + y * y + z * z) / radius))
        volume[i] = np.float32(1.0 / height) / total


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def take_gradients(
    place: Any, offset: Any, neighbor: Any, wall_offset: Any, wall: Any, wall_place: Any,
    wall_volume: Any, radius: float, height: float, volume: float, relaxation: float,
    gradient: Any, total: Any, density: Any, stiffness: Any,
) -> None:  # fmt: skip
    """Write gradients, density and stiffness at places (N, 3).

    `gradient` (3, E) is V∇W of each fluid neighbor, 1/m; `total` (N, 3) its sum over fluid and
    solids; `density` (N,) is ρ/ρ₀, and `stiffness` (N,) α times the relaxation, m².
    """
    top, inverse, own = np.float32(height), np.float32(1.0 / radius), np.float32(volume)
    # Keeps a particle at the same place as another finite.
    least = np.float32(1e-8 * radius)
    regular = np.float32(REGULARIZATION) * inverse * inverse
    scale = own * top * inverse
    count = len(place)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            x, y, z = place[i, 0], place[i, 1], place[i, 2]
            a = b = c = squares = np.float32(0.0)
            filled = spline(np.float32(0.0))
            for e in range(offset[i], offset[i + 1]):
                j = neighbor[e]
                dx, dy, dz = x - place[j, 0], y - place[j, 1], z - place[j, 2]
                distance = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)) + least
                q = distance * inverse
                filled += spline(q)
                factor = scale * slope(q) / distance
                gx, gy, gz = factor * dx, factor * dy, factor * dz
                gradient[0, e], gradient[1, e], gradient[2, e] = gx, gy, gz
                a += gx
                b += gy
                c += gz
                squares += gx * gx + gy * gy + gz * gz
            around = own * top * filled
            for e in range(wall_offset[i], wall_offset[i + 1]):
                j = wall[e]
                dx, dy, dz = x - wall_place[0, j], y - wall_place[1, j], z - wall_place[2, j]
                distance = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)) + least
                q = distance * inverse
                weight = wall_volume[j] * top
                around += weight * spline(q)
                factor = weight * inverse * slope(q) / distance
                a += factor * dx
                b += factor * dy
                c += factor * dz
            total[i, 0], total[i, 1], total[i, 2] = a, b, c
            density[i] = around
            stiffness[i] = np.float32(relaxation) / (a * a + b * b + c * c + squares + regular)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def take_inflow(
    place: Any, wall_offset: Any, wall: Any, wall_place: Any, wall_velocity: Any,
    wall_volume: Any, radius: float, height: float, inflow: Any,
) -> None:  # fmt: skip
    """Write -Σ V_b v_b·∇W over solids that move, the rate (N,) of ρ/ρ₀ that they add, 1/s."""
    top, inverse = np.float32(height / radius), np.float32(1.0 / radius)
    least = np.float32(1e-8 * radius)
    count = len(place)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            rate = np.float32(0.0)
            for e in range(wall_offset[i], wall_offset[i + 1]):
                j = wall[e]
                dx = place[i, 0] - wall_place[0, j]
                dy = place[i, 1] - wall_place[1, j]
                dz = place[i, 2] - wall_place[2, j]
                distance = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)) + least
                factor = wall_volume[j] * top * slope(distance * inverse) / distance
                along = dx * wall_velocity[j, 0] + dy * wall_velocity[j, 1]
                along += dz * wall_velocity[j, 2]
                rate -= factor * along
            inflow[i] = rate


@njit(cache=True, error_model="numpy", fastmath=FAST)
def spline(q: Any) -> Any:
    """Return the cubic spline kernel, 1 at q = 0."""
    far, near = max(np.float32(1.0) - q, np.float32(0.0)), max(np.float32(0.5) - q, np.float32(0.0))
    return np.float32(2.0) * far * far * far - np.float32(8.0) * near * near * near


@njit(cache=True, error_model="numpy", fastmath=FAST)
def slope(q: Any) -> Any:
    """Return the derivative of `spline`."""
    far, near = max(np.float32(1.0) - q, np.float32(0.0)), max(np.float32(0.5) - q, np.float32(0.0))
    return np.float32(24.0) * near * near - np.float32(6.0) * far * far


@njit(cache=True, error_model="numpy", fastmath=FAST)
def divergence(i: int, offset: Any, neighbor: Any, gradient: Any, total: Any, velocity: Any) -> Any:
    """Return Σ V (v_i - v_j)·∇W over the fluid, plus v_i·ΣV∇W over solids at rest, 1/s."""
    rate = (
        velocity[i, 0] * total[i, 0] + velocity[i, 1] * total[i, 1] + velocity[i, 2] * total[i, 2]
    )
    for e in range(offset[i], offset[i + 1]):
        j = neighbor[e]
        rate -= (
            gradient[0, e] * velocity[j, 0]
            + gradient[1, e] * velocity[j, 1]
            + gradient[2, e] * velocity[j, 2]
        )
    return rate


@njit(cache=True, error_model="numpy", fastmath=FAST)
def push_one(
    i: int, offset: Any, neighbor: Any, gradient: Any, total: Any, pressure: Any, velocity: Any
) -> None:
    """Subtract Σ V∇W (p_i + p_j) over the fluid and p_i ΣV∇W over solids from a velocity."""
    p = pressure[i]
    a, b, c = p * total[i, 0], p * total[i, 1], p * total[i, 2]
    for e in range(offset[i], offset[i + 1]):
        p = pressure[neighbor[e]]
        a += gradient[0, e] * p
        b += gradient[1, e] * p
        c += gradient[2, e] * p
    velocity[i, 0] -= a
    velocity[i, 1] -= b
    velocity[i, 2] -= c
