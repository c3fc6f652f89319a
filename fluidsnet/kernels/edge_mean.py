"""Edge network and pooling with gradients, in blocks of edges that stay in the L1 cache.

The backward pass recomputes the activations of a block, so only the neighbor list is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from fluidsnet.kernels.columns import (
    LANES,
    UNITS,
    Layer,
    add_units,
    apply_tanh,
    as_array,
    mean,
    rounded_up,
    row_length,
)
from fluidsnet.kernels.threads import set_threads
from fluidsnet.particles import Particles

# Particles per block and blocks per chunk of a thread; fixed, so that sums do not depend on the
# number of threads.
_PARTICLES, _BLOCKS = 12, 32


def edge_mean(
    particles: Particles, sent: Tensor, neighbor: Tensor, offset: Tensor, layers: Sequence[Layer]
) -> Tensor:
    """Return the mean output (N, W) of two layers over the edges of each particle.

    Tanh, exact to 5e-7, follows each layer. A particle without edges gets zeros.

    Args:
        particles: N fluid particles and M solid ones; they get no gradient.
        sent: (N + M, S) columns that neighbors send; gets no gradient.
        neighbor: (E,) row of the neighbor of each edge.
        offset: (N + 1,) first edge of each fluid particle.
        layers: From offset in support radii and sent columns, 3 + S, to H, and from H to W.
    """
    (weight, bias), second = layers
    # Offsets in m are rounded least, so the weights are scaled instead.
    weight = torch.cat([weight[:, :3] / particles.scene.support_radius, weight[:, 3:]], dim=1)
    rows = torch.cat([torch.cat([particles.position, particles.solid_position]), sent], dim=1)
    pooled: Tensor = _EdgeMean.apply(  # type: ignore[no-untyped-call]
        _with_bias(weight, bias), _with_bias(*second), rows, neighbor, offset, len(bias)
    )
    return pooled


def _with_bias(weight: Tensor, bias: Tensor) -> Tensor:
    """Return the weight (O, I) with the bias as a further column, padded as `padded` does."""
    weight = torch.cat([weight, bias[:, None]], dim=1)
    return torch.nn.functional.pad(weight, (0, -weight.shape[1] % UNITS))


class _EdgeMean(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any, first: Tensor, second: Tensor, rows: Tensor, neighbor: Tensor,
        offset: Tensor, hidden: int,
    ) -> Tensor:  # fmt: skip
        layers = as_array(first), as_array(second)
        context.arrays = (*layers, as_array(rows), neighbor.numpy(), offset.numpy(), hidden)
        pooled = np.empty((len(offset) - 1, len(second)), np.float32)
        set_threads(len(pooled))
        _forward(*context.arrays, pooled)  # type: ignore[call-arg]
        return torch.from_numpy(pooled)

    @staticmethod
    def backward(context: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        gradient = as_array(gradients[0])
        first, second = context.arrays[:2]
        chunks = -(-len(gradient) // (_PARTICLES * _BLOCKS))
        parts = [np.zeros((chunks, *layer.shape), np.float32) for layer in (first, second)]
        set_threads(len(gradient))
        _backward(*context.arrays, gradient, *parts)  # type: ignore[call-arg]
        sums = (part.sum(axis=0, dtype=np.float64).astype(np.float32) for part in parts)
        return *map(torch.from_numpy, sums), None, None, None, None


@njit(cache=True, parallel=True, error_model="numpy")
def _forward(
    first: Any, second: Any, rows: Any, neighbor: Any, offset: Any, hidden: int, pooled: Any
) -> None:
    """Write `edge_mean`; the layers (H, I), (W, H + 1) hold their biases and are padded."""
    count = len(pooled)
    for chunk in prange((count + _PARTICLES * _BLOCKS - 1) // (_PARTICLES * _BLOCKS)):
        columns, units, out = _buffers(offset, chunk, count, first, second, len(second))
        for block in range(chunk * _BLOCKS, (chunk + 1) * _BLOCKS):
            begin, end = min(count, block * _PARTICLES), min(count, (block + 1) * _PARTICLES)
            wide = _layers(
                first, second, rows, neighbor, offset, hidden, begin, end, columns, units, out
            )
            for o in range(len(second)):
                apply_tanh(out[o, :wide])
                for i in range(begin, end):
                    edges = out[o, offset[i] - offset[begin] : offset[i + 1] - offset[begin]]
                    pooled[i, o] = mean(edges) if len(edges) else np.float32(0.0)


@njit(cache=True, parallel=True, error_model="numpy")
def _backward(
    first: Any, second: Any, rows: Any, neighbor: Any, offset: Any, hidden: int, gradient: Any,
    first_gradient: Any, second_gradient: Any,
) -> None:  # fmt: skip
    """Write the layers' gradients (chunks, *shape) from that of the means (N, W)."""
    count = len(gradient)
    outputs = rounded_up(len(second), UNITS)
    back = np.zeros((hidden, outputs), np.float32)
    back[:, : len(second)] = second[:, :hidden].T
    for chunk in prange(len(first_gradient)):
        columns, units, out = _buffers(offset, chunk, count, first, second, outputs)
        inner = np.empty(columns.shape[1], np.float32)
        for block in range(chunk * _BLOCKS, (chunk + 1) * _BLOCKS):
            begin, end = min(count, block * _PARTICLES), min(count, (block + 1) * _PARTICLES)
            wide = _layers(
                first, second, rows, neighbor, offset, hidden, begin, end, columns, units, out
            )
            for o in range(len(second)):
                apply_tanh(out[o, :wide])
                for i in range(begin, end):
                    edges = out[o, offset[i] - offset[begin] : offset[i + 1] - offset[begin]]
                    _through_tanh(edges, gradient[i, o] / np.float32(max(len(edges), 1)))
                # Padding has no gradient.
                out[o, offset[end] - offset[begin] : wide] = 0
                _add_products(out[o, :wide], units[:, :wide], second_gradient[chunk, o])
            for h in range(hidden):
                inner[:wide] = 0
                add_units(back[h], out[:, :wide], inner[:wide])
                _times_slope(inner[:wide], units[h, :wide])
                _add_products(inner[:wide], columns[:, :wide], first_gradient[chunk, h])


@njit(cache=True, error_model="numpy")
def _buffers(offset: Any, chunk: int, count: int, first: Any, second: Any, outputs: int) -> Any:
    """Return zeros for inputs, hidden units and outputs of the widest block of a chunk."""
    widest = 0
    for block in range(chunk * _BLOCKS, (chunk + 1) * _BLOCKS):
        begin, end = min(count, block * _PARTICLES), min(count, (block + 1) * _PARTICLES)
        widest = max(widest, offset[end] - offset[begin])
    wide = row_length(widest)
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
    """Write inputs, hidden units, and outputs before tanh; return the padded number of edges."""
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
        apply_tanh(units[h, :wide])
    units[hidden, :wide] = 1
    for o in range(len(second)):
        out[o, :wide] = 0
        add_units(second[o], units[:, :wide], out[o, :wide])
    return wide


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _through_tanh(values: Any, gradient: Any) -> None:
    """Replace the values (E,) of a tanh by the gradient of its inputs."""
    for e in range(len(values)):
        values[e] = gradient * (np.float32(1.0) - values[e] * values[e])


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _times_slope(gradient: Any, values: Any) -> None:
    """Multiply a gradient (E,) by the slope of a tanh with these values."""
    for e in range(len(gradient)):
        gradient[e] *= np.float32(1.0) - values[e] * values[e]


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _add_products(row: Any, columns: Any, out: Any) -> None:
    """Add columns (I, E) times row (E,) to out (I,); I is a multiple of 4."""
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
