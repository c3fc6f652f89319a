"""Kernel-weighted moments of neighbors' features, with gradients, without storing an edge."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from fluidsnet.kernels.columns import as_array
from fluidsnet.kernels.threads import set_threads

#: Number of moments: of order zero, three of order one, six of order two.
MOMENTS = 10
# Particles per chunk of a thread.
_CHUNK = 64


def moments(
    position: Tensor, features: Tensor, neighbor: Tensor, offset: Tensor, radius: float
) -> Tensor:
    """Return the moments (N, 10·C) of the neighbors' features, see `neighbor_moments`.

    Args:
        position: (N, 3) m; gets no gradient.
        features: (N, C).
        neighbor: (E,) row of the neighbor of each edge; for every edge there is the opposite one.
        offset: (N + 1,) first edge of each particle.
        radius: Support radius, m.
    """
    result: Tensor = _Moments.apply(  # type: ignore[no-untyped-call]
        features, position, neighbor, offset, radius
    )
    return result


class _Moments(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any, features: Tensor, position: Tensor, neighbor: Tensor, offset: Tensor,
        radius: float,
    ) -> Tensor:  # fmt: skip
        context.arrays = (as_array(position), neighbor.numpy(), offset.numpy(), 1 / radius)
        values = as_array(features)
        out = np.empty((len(values), MOMENTS * values.shape[1]), np.float32)
        set_threads(len(values))
        _forward(*context.arrays, values, out)  # type: ignore[call-arg]
        return torch.from_numpy(out)

    @staticmethod
    def backward(context: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        gradient = as_array(gradients[0])
        out = np.empty((len(gradient), gradient.shape[1] // MOMENTS), np.float32)
        set_threads(len(gradient))
        _backward(*context.arrays, gradient, out)  # type: ignore[call-arg]
        return torch.from_numpy(out), None, None, None, None


@njit(cache=True, parallel=True, error_model="numpy")
def _forward(place: Any, neighbor: Any, offset: Any, scale: float, values: Any, out: Any) -> None:
    """Write the moments (N, 10·C) of values (N, C)."""
    count = len(values)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        weights = np.zeros((MOMENTS, 1), np.float32)
        for i in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            out[i] = 0
            for e in range(offset[i], offset[i + 1]):
                j = neighbor[e]
                basis(place[i], place[j], np.float32(scale), weights, 0)
                _add_outer(weights[:, 0], values[j], out[i])


@njit(cache=True, parallel=True, error_model="numpy")
def _backward(
    place: Any, neighbor: Any, offset: Any, scale: float, gradient: Any, out: Any
) -> None:
    """Write the gradient of the values (N, C) from that of the moments (N, 10·C).

    The edges are symmetric, so a particle gathers from its own neighbors.
    """
    count = len(out)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        weights = np.zeros((MOMENTS, 1), np.float32)
        for i in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            out[i] = 0
            for e in range(offset[i], offset[i + 1]):
                j = neighbor[e]
                basis(place[j], place[i], np.float32(scale), weights, 0)
                _add_ten(weights[:, 0], gradient[j], out[i])


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def basis(own: Any, other: Any, scale: Any, out: Any, column: int) -> None:
    """Write the ten weights of a neighbor at `other` to a column of out (10, E)."""
    x, y, z = (other[0] - own[0]) * scale, (other[1] - own[1]) * scale, (other[2] - own[2]) * scale
    inside = max(np.float32(1.0) - (x * x + y * y + z * z), np.float32(0.0))
    weight = np.float32(0.3) * inside * inside * inside
    out[0, column] = weight
    first, second = np.float32(2.0) * weight, np.float32(4.0) * weight
    out[1, column], out[2, column], out[3, column] = first * x, first * y, first * z
    out[4, column], out[5, column], out[6, column] = second * x * x, second * y * y, second * z * z
    out[7, column], out[8, column], out[9, column] = second * x * y, second * x * z, second * y * z


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _add_ten(weight: Any, rows: Any, out: Any) -> None:
    """Add weight (10,) times rows, (10·C,) in turn, to out (C,)."""
    width = len(out)
    for half in range(2):
        k = 5 * half
        a, b, c, d, e = weight[k], weight[k + 1], weight[k + 2], weight[k + 3], weight[k + 4]
        row_a, row_b = rows[k * width : (k + 1) * width], rows[(k + 1) * width : (k + 2) * width]
        row_c = rows[(k + 2) * width : (k + 3) * width]
        row_d = rows[(k + 3) * width : (k + 4) * width]
        row_e = rows[(k + 4) * width : (k + 5) * width]
        for u in range(width):
            out[u] += a * row_a[u] + b * row_b[u] + c * row_c[u] + d * row_d[u] + e * row_e[u]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _add_outer(weight: Any, row: Any, out: Any) -> None:
    """Add weight (10,) times row (C,) to out, (10·C,) in turn."""
    width = len(row)
    for half in range(2):
        k = 5 * half
        a, b, c, d, e = weight[k], weight[k + 1], weight[k + 2], weight[k + 3], weight[k + 4]
        out_a, out_b = out[k * width : (k + 1) * width], out[(k + 1) * width : (k + 2) * width]
        out_c = out[(k + 2) * width : (k + 3) * width]
        out_d = out[(k + 3) * width : (k + 4) * width]
        out_e = out[(k + 4) * width : (k + 5) * width]
        for u in range(width):
            value = row[u]
            out_a[u] += a * value
            out_b[u] += b * value
            out_c[u] += c * value
            out_d[u] += d * value
            out_e[u] += e * value
