"""The paper's local feature with its gradients on the CPU, compiled: edges pass block by block.

An edge's numbers stay in the first cache, forward and backward; between the two nothing is kept
of it but its neighbor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from fluidsnet.features.dense import LANES, UNITS, add_units, as_array, mean, rounded_up, squash
from fluidsnet.neighbors.search import Neighbors
from fluidsnet.neighbors.threads import take_threads

# Particles whose edges go through the layers together, and blocks of them that a thread takes
# at a time; fixed, so that sums do not depend on the number of threads.
_PARTICLES, _BLOCKS = 12, 32


#: Weight (O, I) and bias (O,).
Layer = tuple[Tensor, Tensor]


def edge_mean(rows: Tensor, neighbors: Neighbors, first: Layer, second: Layer) -> Tensor:
    """The mean over each particle's neighbors of what two layers make of them.

    Each layer is followed by a tanh that is off by 5e-7 at most.

    Args:
        rows: (P, 3 + S) position of fluid and solid particles, and what they tell as neighbors;
            gets no gradient.
        neighbors: of the N fluid particles, which are the first of the P.
        first: layer from offset and what is told, 3 + S numbers, to H.
        second: layer from H to W numbers.

    Returns:
        (N, W); zeros where there is no neighbor.
    """
    pooled: Tensor = _EdgeMean.apply(  # type: ignore[no-untyped-call]
        _with_bias(*first), _with_bias(*second), rows, neighbors, len(first[1])
    )
    return pooled


def _with_bias(weight: Tensor, bias: Tensor) -> Tensor:
    """Weight (O, I) with the bias as that of a unit more, which is always one; filled up."""
    weight = torch.cat([weight, bias[:, None]], dim=1)
    return torch.nn.functional.pad(weight, (0, -weight.shape[1] % UNITS))


class _EdgeMean(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any, first: Tensor, second: Tensor, rows: Tensor, neighbors: Neighbors, hidden: int
    ) -> Tensor:
        arrays = (
            as_array(first),
            as_array(second),
            as_array(rows),
            neighbors.neighbor.numpy(),
            neighbors.offset.numpy(),
            hidden,
        )
        context.arrays = arrays
        pooled = np.empty((len(neighbors.offset) - 1, len(second)), np.float32)
        take_threads(len(pooled))
        _pool(*arrays, pooled)
        return torch.from_numpy(pooled)

    @staticmethod
    def backward(context: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        gradient = as_array(gradients[0])
        first, second = context.arrays[:2]
        chunks = -(-len(gradient) // (_PARTICLES * _BLOCKS))
        of_first = np.zeros((chunks, *first.shape), np.float32)
        of_second = np.zeros((chunks, *second.shape), np.float32)
        take_threads(len(gradient))
        _pull_back(*context.arrays, gradient, of_first, of_second)  # type: ignore[call-arg]
        sums = (part.sum(axis=0, dtype=np.float64) for part in (of_first, of_second))
        return (*(torch.from_numpy(part.astype(np.float32)) for part in sums), None, None, None)


@njit(cache=True, parallel=True, error_model="numpy")
def _pool(
    first: Any, second: Any, rows: Any, neighbor: Any, offset: Any, hidden: int, pooled: Any
) -> None:
    """`edge_mean`, with the biases in the layers (H, I), (W, H + 1), both filled up."""
    count = len(pooled)
    for chunk in prange((count + _PARTICLES * _BLOCKS - 1) // (_PARTICLES * _BLOCKS)):
        columns, units, out = _room(offset, chunk, count, first, second, len(second))
        for block in range(chunk * _BLOCKS, (chunk + 1) * _BLOCKS):
            begin, end = min(count, block * _PARTICLES), min(count, (block + 1) * _PARTICLES)
            wide = _layers(
                first, second, rows, neighbor, offset, hidden, begin, end, columns, units, out
            )
            for o in range(len(second)):
                squash(out[o, :wide])
                for i in range(begin, end):
                    edges = out[o, offset[i] - offset[begin] : offset[i + 1] - offset[begin]]
                    pooled[i, o] = mean(edges) if len(edges) else np.float32(0.0)


@njit(cache=True, parallel=True, error_model="numpy")
def _pull_back(
    first: Any, second: Any, rows: Any, neighbor: Any, offset: Any, hidden: int, gradient: Any,
    of_first: Any, of_second: Any,
) -> None:  # fmt: skip
    """Gradients of the layers (chunks, *shape), a part a chunk, from that of the means (N, W)."""
    count = len(gradient)
    outputs = rounded_up(len(second), UNITS)
    back = np.zeros((hidden, outputs), np.float32)
    back[:, : len(second)] = second[:, :hidden].T
    for chunk in prange(len(of_first)):
        columns, units, out = _room(offset, chunk, count, first, second, outputs)
        inner = np.empty(columns.shape[1], np.float32)
        for block in range(chunk * _BLOCKS, (chunk + 1) * _BLOCKS):
            begin, end = min(count, block * _PARTICLES), min(count, (block + 1) * _PARTICLES)
            wide = _layers(
                first, second, rows, neighbor, offset, hidden, begin, end, columns, units, out
            )
            for o in range(len(second)):
                squash(out[o, :wide])
                for i in range(begin, end):
                    edges = out[o, offset[i] - offset[begin] : offset[i + 1] - offset[begin]]
                    _through_tanh(edges, gradient[i, o] / np.float32(max(len(edges), 1)))
                # What fills up has no gradient.
                out[o, offset[end] - offset[begin] : wide] = 0
                _add_products(out[o, :wide], units[:, :wide], of_second[chunk, o])
            for h in range(hidden):
                inner[:wide] = 0
                add_units(back[h], out[:, :wide], inner[:wide])
                _times_slope(inner[:wide], units[h, :wide])
                _add_products(inner[:wide], columns[:, :wide], of_first[chunk, h])


@njit(cache=True, error_model="numpy")
def _room(offset: Any, chunk: int, count: int, first: Any, second: Any, outputs: int) -> Any:
    """Zeros for inputs, hidden units and outputs of the widest of a chunk's blocks."""
    widest = 0
    for block in range(chunk * _BLOCKS, (chunk + 1) * _BLOCKS):
        begin, end = min(count, block * _PARTICLES), min(count, (block + 1) * _PARTICLES)
        widest = max(widest, offset[end] - offset[begin])
    # Not a power of two from row to row, as those share few places in the cache.
    wide = rounded_up(widest, LANES) | LANES
    return (
        np.zeros((first.shape[1], wide), np.float32),
        np.zeros((second.shape[1], wide), np.float32),
        np.zeros((outputs, wide), np.float32),
    )


@njit(cache=True, error_model="numpy")
def _layers(
    first: Any, second: Any, rows: Any, neighbor: Any, offset: Any, hidden: int, begin: int,
    end: int, columns: Any, units: Any, out: Any,
) -> Any:  # fmt: skip
    """Fills in inputs, hidden units, and outputs before their tanh; returns how wide they are."""
    at = 0
    for i in range(begin, end):
        for edge in range(offset[i], offset[i + 1]):
            other = rows[neighbor[edge]]
            for axis in range(3):
                columns[axis, at] = other[axis] - rows[i, axis]
            for unit in range(3, rows.shape[1]):
                columns[unit, at] = other[unit]
            at += 1
    wide = rounded_up(at, LANES)
    columns[rows.shape[1], :wide] = 1
    for h in range(hidden):
        units[h, :wide] = 0
        add_units(first[h], columns[:, :wide], units[h, :wide])
        squash(units[h, :wide])
    units[hidden, :wide] = 1
    for o in range(len(second)):
        out[o, :wide] = 0
        add_units(second[o], units[:, :wide], out[o, :wide])
    return wide


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _through_tanh(values: Any, gradient: Any) -> None:
    """Puts a tanh's gradient before it in the place of its values, (E,)."""
    for e in range(len(values)):
        values[e] = gradient * (np.float32(1.0) - values[e] * values[e])


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _times_slope(gradient: Any, values: Any) -> None:
    """Takes a gradient (E,) back through a tanh whose values are given."""
    for e in range(len(gradient)):
        gradient[e] *= np.float32(1.0) - values[e] * values[e]


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _add_products(row: Any, columns: Any, out: Any) -> None:
    """Adds to (I,) the products of a row (E,) with the columns (I, E); I a multiple of 4."""
    for i in range(0, len(columns), 4):
        a = b = c = d = np.float32(0.0)
        col_a, col_b, col_c, col_d = columns[i], columns[i + 1], columns[i + 2], columns[i + 3]
        for e in range(len(row)):
            a += row[e] * col_a[e]
            b += row[e] * col_b[e]
            c += row[e] * col_c[e]
            d += row[e] * col_d[e]
        out[i] += a
        out[i + 1] += b
        out[i + 2] += c
        out[i + 3] += d
