"""Kernel of the coarse SPH step of `fluidsnet.priors.PressureStep`.

Arrays have a row for each fluid particle in the order of its cell table, and the lists of
neighbors are those of the whole step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fluidsnet.kernels.near_lists import NearLists
from fluidsnet.kernels.sph_sums import (
    CHUNK,
    FAST,
    divergence,
    push_one,
    take_gradients,
    take_inflow,
)

Array = NDArray[np.float32]


class Walls(NamedTuple):
    """Solid particles in the order of their cell table.

    Attributes:
        place: (3, M) in the middle of the substeps, m.
        volume: (M,) m³.
        velocity: (M, 3) m/s; (0, 3) where they rest.
    """

    place: Array
    volume: Array
    velocity: Array


class Boxes(NamedTuple):
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
    height: float  # of the SPH kernel, 1/m³; in two dimensions 1/m²
    volume: float  # of a fluid particle, m³; in two dimensions m²
    viscous: float  # factor of the viscosity
    substep: float  # s
    mean_weight: float  # a: weight of the new velocity in the displacement
    ahead: float  # share of a substep after which gradients are taken
    sweeps: int
    divergence_sweeps: int
    relaxation: float
    warm_start: float
    divergence_warm_start: float


class State(NamedTuple):
    """State of the prior that a network may use; each (N,) or (N, 3) float32.

    Attributes:
        middle: Place at which the last gradients were taken, m.
        density: ρ/ρ₀ there.
        surface: Sum of V∇W over fluid and solids there, 1/m.
        divergence: Rate of ρ/ρ₀ of the velocity before the step, 1/s.
        left: Rate of ρ/ρ₀ that is left after the step, 1/s.
        divergence_pressure, pressure: Of the two phases of the last substep, m²/s.
    """

    middle: Array
    density: Array
    surface: Array
    divergence: Array
    left: Array
    divergence_pressure: Array
    pressure: Array


@njit(cache=True, error_model="numpy")
def pressure_step(
    place: Any, velocity: Any, frame: Any, lists: NearLists, walls: Walls, boxes: Boxes,
    numbers: Numbers, substeps: int, state: State,
) -> None:  # fmt: skip
    """Step places and velocities (N, 3), m and m/s, in place, and write the state."""
    count, step = len(place), np.float32(numbers.substep)
    gradient = np.empty((3, len(lists.neighbor)), np.float32)
    stiffness = np.empty(count, np.float32)
    before, driven = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    change = np.empty(count, np.float32)
    moving = len(walls.velocity) > 0
    # Rates that are added to the divergence: of the walls, and with the excess density.
    inflow, excess = np.zeros(count, np.float32), np.empty(count, np.float32)
    # Of the same layout as the places at rest, or numba takes both for strided and is slower.
    wall_place = np.empty(walls.place.shape, np.float32) if moving else walls.place
    middle, total, density = state.middle, state.surface, state.density
    upkeep, pressure = state.divergence_pressure, state.pressure
    offset, neighbor = lists.offset, lists.neighbor
    # Each loop over the particles is a function of its own that takes plain arrays: numba fuses
    # loops that read what the one before wrote for other particles, and corrupts named tuples.
    for substep in range(substeps):
        _look_ahead(
            place, velocity, frame, boxes.lower, boxes.upper, np.float32(numbers.ahead) * step,
            middle, before,
        )  # fmt: skip
        if moving:
            time = np.float32(substep + numbers.ahead - substeps / 2) * step
            _carry(walls.place, walls.velocity, time, wall_place)
            take_inflow(
                middle, lists.wall_offset, lists.wall, wall_place, walls.velocity, walls.volume,
                numbers.radius, numbers.height, inflow,
            )  # fmt: skip
        take_gradients(
            middle, offset, neighbor, lists.wall_offset, lists.wall, wall_place, walls.volume,
            numbers.radius, numbers.height, numbers.volume, numbers.relaxation, gradient, total,
            density, stiffness,
        )  # fmt: skip
        if substep == 0:
            _diverge(offset, neighbor, gradient, total, velocity, inflow, state.divergence)
        upkeep *= np.float32(numbers.divergence_warm_start)
        pressure *= np.float32(numbers.warm_start)
        _push(offset, neighbor, gradient, total, upkeep, velocity)
        for _ in range(numbers.divergence_sweeps):
            _raise(
                offset, neighbor, gradient, total, stiffness, velocity, inflow, upkeep, change,
            )  # fmt: skip
            _push(offset, neighbor, gradient, total, change, velocity)
        driven[:] = velocity
        _add_forces(
            frame, middle, offset, neighbor, gradient, total, density, driven, boxes.viscosity,
            boxes.gravity, step, numbers.viscous, numbers.radius, pressure, velocity,
        )  # fmt: skip
        _exceed(density, inflow, np.float32(1.0) / step, excess)
        for _ in range(numbers.sweeps):
            _raise(
                offset, neighbor, gradient, total, stiffness, velocity, excess, pressure, change,
            )  # fmt: skip
            _push(offset, neighbor, gradient, total, change, velocity)
        _move(
            place, velocity, frame, boxes.lower, boxes.upper, step, np.float32(numbers.mean_weight),
            before,
        )  # fmt: skip
    _diverge(offset, neighbor, gradient, total, velocity, inflow, state.left)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def _carry(place: Any, velocity: Any, time: Any, out: Any) -> None:
    """Write the places (3, M) of solids a time (s) later, given their velocities (M, 3)."""
    for i in prange(len(velocity)):
        for axis in range(3):
            out[axis, i] = place[axis, i] + time * velocity[i, axis]


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def _look_ahead(
    place: Any, velocity: Any, frame: Any, lower: Any, upper: Any, time: Any, middle: Any,
    before: Any,
) -> None:  # fmt: skip
    """Write the places (N, 3) a time (s) later, and the velocities before."""
    for i in prange(len(place)):
        for axis in range(3):
            value = place[i, axis] + time * velocity[i, axis]
            middle[i, axis] = min(max(value, lower[frame[i], axis]), upper[frame[i], axis])
            before[i, axis] = velocity[i, axis]


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def _diverge(
    offset: Any, neighbor: Any, gradient: Any, total: Any, velocity: Any, inflow: Any, out: Any
) -> None:
    """Write the rate (N,) of ρ/ρ₀ of velocities (N, 3), with that of solids that move."""
    count = len(out)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            out[i] = divergence(i, offset, neighbor, gradient, total, velocity) + inflow[i]


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def _raise(
    offset: Any, neighbor: Any, gradient: Any, total: Any, stiffness: Any, velocity: Any,
    added: Any, pressure: Any, change: Any,
) -> None:  # fmt: skip
    """Raise pressures (N,) by divergence and added rates, to zero at least; write by how much."""
    count = len(pressure)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            rate = divergence(i, offset, neighbor, gradient, total, velocity) + added[i]
            raised = max(pressure[i] + stiffness[i] * rate, np.float32(0.0))
            change[i] = raised - pressure[i]
            pressure[i] = raised


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def _exceed(density: Any, inflow: Any, inverse_step: Any, out: Any) -> None:
    """Write the rates (N,) that remove the excess density in a substep, and those of the walls."""
    for i in prange(len(out)):
        out[i] = (density[i] - np.float32(1.0)) * inverse_step + inflow[i]


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def _push(
    offset: Any, neighbor: Any, gradient: Any, total: Any, pressure: Any, velocity: Any
) -> None:
    """Subtract the push of pressures (N,) from velocities (N, 3)."""
    count = len(velocity)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            push_one(i, offset, neighbor, gradient, total, pressure, velocity)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
def _add_forces(
    frame: Any, place: Any, offset: Any, neighbor: Any, gradient: Any, total: Any, density: Any,
    before: Any, viscosity: Any, gravity: Any, step: Any, viscous: float, radius: float,
    pressure: Any, velocity: Any,
) -> None:  # fmt: skip
    """Add viscosity between fluid particles, gravity, and the push of pressures to velocities."""
    count, least = len(velocity), np.float32(0.01 * radius * radius)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        for i in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK)):
            factor = np.float32(viscous) * step * viscosity[frame[i]]
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
            velocity[i, 0] = u + factor * a + step * gravity[frame[i], 0]
            velocity[i, 1] = v + factor * b + step * gravity[frame[i], 1]
            velocity[i, 2] = w + factor * c + step * gravity[frame[i], 2]
            push_one(i, offset, neighbor, gradient, total, pressure, velocity)


@njit(cache=True, parallel=True, error_model="numpy", fastmath=FAST)
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
