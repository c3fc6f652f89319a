"""Search, edge network and pooling in one pass, which stores no edge.

The first layer of the paper's local feature (section 4.3) is linear in neighbor minus particle:
it is applied once to each candidate of a cell, and an edge is a difference.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit, prange
from numpy.typing import NDArray
from torch import Tensor

from fluidsnet.kernels import nearest
from fluidsnet.kernels.cell_table import CellTable, is_finite
from fluidsnet.kernels.columns import (
    LANES,
    UNITS,
    add_units,
    apply_tanh,
    as_array,
    mean,
    rounded_up,
)
from fluidsnet.particles import Particles

# Edges per pass through the layers: few enough to stay in the L1 cache.
_EDGES = 448


class EdgeLayers(NamedTuple):
    """Two layers of an edge network over [offset, velocity, marker]; all float32.

    Attributes:
        offset: (H, 3) weight of the first layer for offsets, 1/m.
        velocity: (H, 3) weight of the first layer for velocities, s/m.
        fluid: (H,) bias of the first layer for fluid neighbors.
        solid: (H,) bias of the first layer for solid neighbors.
        weight: (W, H) weight of the second layer, `padded`.
        bias: (W,) bias of the second layer.
    """

    offset: NDArray[np.float32]
    velocity: NDArray[np.float32]
    fluid: NDArray[np.float32]
    solid: NDArray[np.float32]
    weight: NDArray[np.float32]
    bias: NDArray[np.float32]


def fused_edge_mean(
    particles: Particles, tables: tuple[CellTable, CellTable], layers: EdgeLayers, k: int
) -> Tensor:
    """Return the mean output of the layers over the neighbors of each fluid particle, (N, W).

    A particle without neighbors gets zeros.

    Args:
        particles: N fluid particles and the solid ones.
        tables: Cell tables of fluid and solids.
        layers: Edge network.
        k: Maximum number of neighbors; the nearest, of equally far ones the lower rows.
    """
    fluid, solids = tables
    pooled = np.empty((len(particles), len(layers.bias)), np.float32)
    _pool(
        fluid,
        solids,
        _sort(as_array(particles.velocity), fluid.row),
        _sort(as_array(particles.solid_velocity), solids.row),
        layers,
        np.float32(particles.scene.support_radius**2),
        k,
        pooled,
    )
    return torch.from_numpy(pooled)


@njit(cache=True, parallel=True, error_model="numpy")
def _sort(velocity: Any, row: Any) -> Any:
    """Return velocities (P, 3) in the order of cells, (3, P)."""
    result = np.empty((3, len(row)), np.float32)
    for s in prange(len(row)):
        for axis in range(3):
            result[axis, s] = velocity[row[s], axis]
    return result


@njit(cache=True, parallel=True, error_model="numpy")
def _pool(
    fluid: CellTable, solids: CellTable, fluid_velocity: Any, solid_velocity: Any,
    layers: EdgeLayers, limit: Any, k: int, pooled: Any,
) -> None:  # fmt: skip
    """Write `fused_edge_mean`; velocities (3, P) in the order of the cells, limit in m²."""
    count, hidden = len(fluid.row), len(layers.fluid)
    for block in prange((count + nearest.BLOCK - 1) // nearest.BLOCK):
        cell, begin, end = np.full(4, np.nan), np.empty(54, np.int64), np.empty(54, np.int64)
        room = 1024
        place, speed = np.empty((3, room), np.float32), np.empty((3, room), np.float32)
        row, near = np.empty(room, np.int32), np.empty(room, np.int32)
        squared, sent = np.empty(room, np.float32), np.empty((hidden, room), np.float32)
        key = np.empty(2 * k + 512, np.int64)
        spare, bins = np.empty(len(key), np.int64), np.empty(len(key), np.int32)
        start = np.empty(nearest.BINS, np.int32)
        # Edges of several particles; zeros for units that are padding.
        most = rounded_up(_EDGES + k, LANES)
        edges = np.zeros((rounded_up(hidden, UNITS), most), np.float32)
        result = np.empty(most, np.float32)
        owner, until = np.empty(most, np.int64), np.empty(most, np.int64)
        candidates, shift, waiting, filled = 0, 0, 0, 0
        origin = np.zeros(3, np.float32)
        for s in range(block * nearest.BLOCK, min(count, (block + 1) * nearest.BLOCK)):
            x, y, z = fluid.place[0, s], fluid.place[1, s], fluid.place[2, s]
            mine = fluid.row[s]
            pooled[mine] = 0
            if not is_finite(x, y, z):
                continue
            if nearest.enters(fluid, s, cell):
                runs, all_runs = nearest.look_around(fluid, solids, cell, begin, end)
                candidates = (end[:all_runs] - begin[:all_runs]).sum()
                if candidates > room:
                    room = 2 * candidates
                    place, speed = np.empty((3, room), np.float32), np.empty((3, room), np.float32)
                    row, near = np.empty(room, np.int32), np.empty(room, np.int32)
                    squared = np.empty(room, np.float32)
                    sent = np.empty((hidden, room), np.float32)
                wet = nearest.collect(fluid, solids, begin, end, runs, all_runs, place, row)
                _copy(fluid_velocity, begin[:runs], end[:runs], speed, 0)
                _copy(solid_velocity, begin[runs:all_runs], end[runs:all_runs], speed, wet)
                # Coordinates relative to a near point, since float32 is coarse far from zero.
                origin[0], origin[1], origin[2] = x, y, z
                for h in range(hidden):
                    to, constant = sent[h], layers.fluid[h]
                    _send(place, speed, origin, layers, h, constant, to, 0, wet)
                    constant = layers.solid[h]
                    _send(place, speed, origin, layers, h, constant, to, wet, candidates)
                shift = _shift(s, begin, end, runs)
            nearest.measure(place[0, :candidates], place[1], place[2], x, y, z, squared)
            squared[s - shift] = np.inf
            found = nearest.list_near(squared, candidates, limit, near)
            if found > k + nearest.DROPPED:
                nearest.within(squared, row, candidates, mine, limit, k, key, spare, bins, start)
                found = nearest.keep_up_to(key[k - 1], squared, row, near, found)
            else:
                found = nearest.drop_farthest(squared, row, near, found, k)
            if found == 0:
                continue
            for h in range(hidden):
                along = layers.offset[h]
                own = along[0] * (x - origin[0]) + along[1] * (y - origin[1])
                own += along[2] * (z - origin[2])
                _subtract(sent[h], near, own, edges[h, filled : filled + found])
            filled += found
            owner[waiting], until[waiting] = mine, filled
            waiting += 1
            if filled > _EDGES:
                _flush(edges, filled, layers, result, owner, until, waiting, pooled)
                waiting = filled = 0
        _flush(edges, filled, layers, result, owner, until, waiting, pooled)


@njit(cache=True, error_model="numpy")
def _copy(values: Any, begin: Any, end: Any, to: Any, filled: int) -> None:
    """Copy runs of values (3, P) to `to` from `filled` on."""
    at: Any = np.uint64(filled)
    for run in range(len(begin)):
        for s in range(np.uint64(begin[run]), np.uint64(end[run])):
            to[0, at] = values[0, s]
            to[1, at] = values[1, s]
            to[2, at] = values[2, s]
            at += np.uint64(1)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _send(
    place: Any, speed: Any, origin: Any, layers: EdgeLayers, h: int, constant: Any, to: Any,
    first: int, last: int,
) -> None:  # fmt: skip
    """Write the input of a hidden unit from the candidates first to last."""
    along, across = layers.offset[h], layers.velocity[h]
    xs, ys, zs = place[0, first:last], place[1, first:last], place[2, first:last]
    us, vs, ws = speed[0, first:last], speed[1, first:last], speed[2, first:last]
    out = to[first:last]
    x, y, z = origin[0], origin[1], origin[2]
    a, b, c, d, e, f = along[0], along[1], along[2], across[0], across[1], across[2]
    for i in range(len(out)):
        value = constant + a * (xs[i] - x) + b * (ys[i] - y) + c * (zs[i] - z)
        out[i] = value + d * us[i] + e * vs[i] + f * ws[i]


@njit(cache=True, error_model="numpy")
def _shift(s: int, begin: Any, end: Any, runs: int) -> Any:
    """Return the index in the order of cells, less that among the candidates, of a particle."""
    before = 0
    for run in range(runs):
        if begin[run] <= s < end[run]:
            return begin[run] - before
        before += end[run] - begin[run]
    return 0


@njit(cache=True, error_model="numpy")
def _subtract(sent: Any, near: Any, own: Any, to: Any) -> None:
    """Write the first layer before tanh for the edges to the candidates in `near`."""
    for i in range(len(to)):
        to[i] = sent[np.uint32(near[i])] - own


@njit(cache=True, error_model="numpy")
def _flush(
    edges: Any, filled: int, layers: EdgeLayers, result: Any, owner: Any, until: Any,
    waiting: int, pooled: Any,
) -> None:  # fmt: skip
    """Apply tanh and the second layer to the edges and pool them."""
    wide = rounded_up(filled, LANES)
    for h in range(len(layers.fluid)):
        apply_tanh(edges[h, :wide])
    out = result[:wide]
    for o in range(len(layers.bias)):
        out[:] = layers.bias[o]
        add_units(layers.weight[o], edges, out)
        apply_tanh(out)
        begin = 0
        for i in range(waiting):
            pooled[owner[i], o] = mean(out[begin : until[i]])
            begin = until[i]
