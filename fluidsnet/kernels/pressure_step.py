"""Kernel of the coarse SPH step of `fluidsnet.priors.PressureStep`.

Arrays have a row for each fluid particle in the order of its cell table, and the lists of
neighbors are those of the whole step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fluidsnet.kernels.near_lists import NearLists

Array = NDArray[np.float32]

# Particles per task of a thread.
_CHUNK = 64
# Order of sums may change, values that are not finite stay so.
_FAST = {"contract", "reassoc", "nsz", "arcp"}

#: Share of the inverse squared support radius that is added to the diagonal of the pressure
#: system, which bounds the pressure of a particle with few neighbors.
REGULARIZATION = 0.01


class Walls(NamedTuple):
    """Solid particles in the order of their cell table.

    Attributes:
        place: (3, M) m.
        volume: (M,) m³.
    """

    place: Array
    volume: Array


class Box(NamedTuple):
    """Scene of each frame.

    Attributes:
        lower: (F, 3) corner that the centers of particles stay above, m.
        upper: (F, 3) m.
        gravity: (F, 3) m/s².
        viscosity: (F,) m²/s.
    """

    lower: Array
    upper: Array
    gravity: Array
    viscosity: Array


class Numbers(NamedTuple):
    """Numbers of a step, see `PressureStep`."""

    radius: float  # support radius, m
    volume: float  # of a fluid particle, m³
    substep: float  # s
    mean_weight: float  # a: weight of the new velocity in the displacement
    sweeps: int
    divergence_sweeps: int
    relaxation: float
    warm_start: float


class State(NamedTuple):
    """State of the prior that a network may use; each (N,) or (N, 3) float32.

    Attributes:
        middle: Place at which the last gradients were taken, m.
        density: ρ/ρ₀ there.
        surface: Sum of V∇W over fluid and solids there, 1/m.
        neighbors: Number of neighbors, fluid and solid.
        divergence: Rate of ρ/ρ₀ of the velocity before the step, 1/s.
        left: Rate of ρ/ρ₀ that is left after the step, 1/s.
        divergence_pressure, pressure: Of the two phases of the last substep, m²/s.
    """

    middle: Array
    density: Array
    surface: Array
    neighbors: Array
    divergence: Array
    left: Array
    divergence_pressure: Array
    pressure: Array


@njit(cache=True, error_model="numpy")
def pressure_step(
    place: Any, velocity: Any, frame: Any, lists: NearLists, walls: Walls, box: Box,
    numbers: Numbers, substeps: int, state: State,
) -> None:  # fmt: skip
    """Step places and velocities (N, 3), m and m/s, in place, and write the state."""
    count, step = len(place), np.float32(numbers.substep)
    gradient = np.empty((3, len(lists.neighbor)), np.float32)
    stiffness = np.empty(count, np.float32)
    before, change = np.empty((count, 3), np.float32), np.empty(count, np.float32)
    middle, total, density = state.middle, state.surface, state.density
    upkeep, pressure = state.divergence_pressure, state.pressure
    offset, neighbor = lists.offset, lists.neighbor
    # Each loop over the particles is a function of its own that takes plain arrays: numba fuses
    # loops that read what the one before wrote for other particles, and corrupts named tuples.
    for substep in range(substeps):
        _move_to_middle(place, velocity, frame, box.lower, box.upper, step, middle, before)
        _take_gradients(
            middle, offset, neighbor, lists.wall_offset, lists.wall, walls.place, walls.volume,
            numbers.radius, numbers.volume, numbers.relaxation, gradient, total, density, stiffness,
        )  # fmt: skip
        if substep == 0:
            _diverge(offset, neighbor, gradient, total, velocity, state.divergence)
        upkeep *= np.float32(numbers.warm_start)
        pressure *= np.float32(numbers.warm_start)
        _add_viscosity(
            frame, middle, offset, neighbor, gradient, total, density, before, box.viscosity, step,
            numbers.radius, upkeep, velocity,
        )  # fmt: skip
        for _ in range(numbers.divergence_sweeps):
            _raise(
                offset, neighbor, gradient, total, density, stiffness, velocity, np.float32(0.0),
                upkeep, change,
            )  # fmt: skip
            _push(offset, neighbor, gradient, total, change, velocity)
        _add_gravity(
            frame, offset, neighbor, gradient, total, box.gravity, step, pressure, velocity
        )
        for _ in range(numbers.sweeps):
            _raise(
                offset, neighbor, gradient, total, density, stiffness, velocity,
                np.float32(1.0) / step, pressure, change,
            )  # fmt: skip
            _push(offset, neighbor, gradient, total, change, velocity)
        _move(
            place, velocity, frame, box.lower, box.upper, step, np.float32(numbers.mean_weight),
            before,
        )  # fmt: skip
    _diverge(offset, neighbor, gradient, total, velocity, state.left)
    for i in range(count):
        solids = lists.wall_offset[i + 1] - lists.wall_offset[i]
        state.neighbors[i] = np.float32(offset[i + 1] - offset[i] + solids)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _move_to_middle(
    place: Any, velocity: Any, frame: Any, lower: Any, upper: Any, step: Any, middle: Any,
    before: Any,
) -> None:  # fmt: skip
    """Write the places (N, 3) half a substep later, and the velocities before it."""
    for i in prange(len(place)):
        for axis in range(3):
            value = place[i, axis] + np.float32(0.5) * step * velocity[i, axis]
            middle[i, axis] = min(max(value, lower[frame[i], axis]), upper[frame[i], axis])
            before[i, axis] = velocity[i, axis]


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _take_gradients(
    place: Any, offset: Any, neighbor: Any, wall_offset: Any, wall: Any, wall_place: Any,
    wall_volume: Any, radius: float, volume: float, relaxation: float, gradient: Any, total: Any,
    density: Any, stiffness: Any,
) -> None:  # fmt: skip
    """Write gradients, density and stiffness at places (N, 3).

    `gradient` (3, E) is V∇W of each fluid neighbor, 1/m; `total` (N, 3) its sum over fluid and
    solids; `density` (N,) is ρ/ρ₀, and `stiffness` (N,) α times the relaxation, m².
    """
    height = np.float32(8.0 / (math.pi * radius**3))
    inverse, own = np.float32(1.0 / radius), np.float32(volume)
    # Keeps a particle at the same place as another finite.
    least = np.float32(1e-8 * radius)
    regular = np.float32(REGULARIZATION) * inverse * inverse
    scale = own * height * inverse
    count = len(place)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
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
            around = own * height * filled
            for e in range(wall_offset[i], wall_offset[i + 1]):
                j = wall[e]
                dx, dy, dz = x - wall_place[0, j], y - wall_place[1, j], z - wall_place[2, j]
                distance = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)) + least
                q = distance * inverse
                weight = wall_volume[j] * height
                around += weight * spline(q)
                factor = weight * inverse * slope(q) / distance
                a += factor * dx
                b += factor * dy
                c += factor * dz
            total[i, 0], total[i, 1], total[i, 2] = a, b, c
            density[i] = around
            stiffness[i] = np.float32(relaxation) / (a * a + b * b + c * c + squares + regular)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _diverge(
    offset: Any, neighbor: Any, gradient: Any, total: Any, velocity: Any, out: Any
) -> None:
    """Write the rate (N,) of ρ/ρ₀ of velocities (N, 3)."""
    count = len(out)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            out[i] = _divergence(i, offset, neighbor, gradient, total, velocity)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _raise(
    offset: Any, neighbor: Any, gradient: Any, total: Any, density: Any, stiffness: Any,
    velocity: Any, inverse_step: Any, pressure: Any, change: Any,
) -> None:  # fmt: skip
    """Raise pressures (N,) by divergence and excess density, to zero at least; write by how much.

    The excess density counts by the inverse substep; zero leaves it out.
    """
    count = len(pressure)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            rate = _divergence(i, offset, neighbor, gradient, total, velocity)
            rate += (density[i] - np.float32(1.0)) * inverse_step
            raised = max(pressure[i] + stiffness[i] * rate, np.float32(0.0))
            change[i] = raised - pressure[i]
            pressure[i] = raised


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _push(
    offset: Any, neighbor: Any, gradient: Any, total: Any, pressure: Any, velocity: Any
) -> None:
    """Subtract the push of pressures (N,) from velocities (N, 3)."""
    count = len(velocity)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            _push_one(i, offset, neighbor, gradient, total, pressure, velocity)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _add_viscosity(
    frame: Any, place: Any, offset: Any, neighbor: Any, gradient: Any, total: Any, density: Any,
    before: Any, viscosity: Any, step: Any, radius: float, pressure: Any, velocity: Any,
) -> None:  # fmt: skip
    """Add viscosity between fluid particles and the push of pressures (N,) to velocities."""
    count, least = len(velocity), np.float32(0.01 * radius * radius)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            factor = np.float32(10.0) * step * viscosity[frame[i]]
            x, y, z = place[i, 0], place[i, 1], place[i, 2]
            u, v, w = before[i, 0], before[i, 1], before[i, 2]
            a = b = c = np.float32(0.0)
            if factor > 0:
                for e in range(offset[i], offset[i + 1]):
                    j = neighbor[e]
                    dx, dy, dz = x - place[j, 0], y - place[j, 1], z - place[j, 2]
                    along = (u - before[j, 0]) * dx + (v - before[j, 1]) * dy
                    along += (w - before[j, 2]) * dz
                    along /= (dx * dx + dy * dy + dz * dz + least) * density[j]
                    a += along * gradient[0, e]
                    b += along * gradient[1, e]
                    c += along * gradient[2, e]
            velocity[i, 0] = u + factor * a
            velocity[i, 1] = v + factor * b
            velocity[i, 2] = w + factor * c
            _push_one(i, offset, neighbor, gradient, total, pressure, velocity)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _add_gravity(
    frame: Any, offset: Any, neighbor: Any, gradient: Any, total: Any, gravity: Any, step: Any,
    pressure: Any, velocity: Any,
) -> None:  # fmt: skip
    """Add gravity and the push of pressures (N,) to velocities (N, 3)."""
    count = len(velocity)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            for axis in range(3):
                velocity[i, axis] += step * gravity[frame[i], axis]
            _push_one(i, offset, neighbor, gradient, total, pressure, velocity)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def _move(
    place: Any, velocity: Any, frame: Any, lower: Any, upper: Any, step: Any, weight: Any,
    before: Any,
) -> None:  # fmt: skip
    """Move places (N, 3) over a substep; particles beyond a wall stop at it."""
    for i in prange(len(place)):
        for axis in range(3):
            mean = before[i, axis] + weight * (velocity[i, axis] - before[i, axis])
            value = place[i, axis] + step * mean
            low, high = lower[frame[i], axis], upper[frame[i], axis]
            if (value < low and velocity[i, axis] < 0) or (value > high and velocity[i, axis] > 0):
                velocity[i, axis] = 0
            place[i, axis] = min(max(value, low), high)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=_FAST)
def solid_volumes(place: Any, lists: NearLists, radius: float, volume: Any) -> None:
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
        volume[i] = np.float32(math.pi * radius**3 / 8) / total


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def spline(q: Any) -> Any:
    """Return the cubic spline kernel, 1 at q = 0."""
    far, near = max(np.float32(1.0) - q, np.float32(0.0)), max(np.float32(0.5) - q, np.float32(0.0))
    return np.float32(2.0) * far * far * far - np.float32(8.0) * near * near * near


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def slope(q: Any) -> Any:
    """Return the derivative of `spline`."""
    far, near = max(np.float32(1.0) - q, np.float32(0.0)), max(np.float32(0.5) - q, np.float32(0.0))
    return np.float32(24.0) * near * near - np.float32(6.0) * far * far


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _divergence(
    i: int, offset: Any, neighbor: Any, gradient: Any, total: Any, velocity: Any
) -> Any:
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


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _push_one(
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
