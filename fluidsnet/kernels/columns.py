"""Dense layers over columns: the values of one unit are contiguous, (units, E)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

#: Weight (O, I) and bias (O,) of a linear layer.
Layer = tuple[Tensor, Tensor]

#: Units that are added to an output at once: as many as leave registers free.
UNITS = 8
#: Vectorized loops are fastest over multiples of this number of columns.
LANES = 32

# tanh(x) ≈ x·P(x²) / Q(x²), the minimax ratio of these degrees on [-8, 8]: error 1.3e-7 before
# rounding. Beyond ±8 tanh is ±1 within 3e-7. Q begins with 1.
_END = np.float32(8.0)
_P0 = np.float32(0.999999362)
_P1 = np.float32(0.129136395)
_P2 = np.float32(2.93882587e-3)
_P3 = np.float32(1.13102059e-5)
_Q1 = np.float32(0.462467382)
_Q2 = np.float32(2.37638193e-2)
_Q3 = np.float32(2.37028223e-4)
_Q4 = np.float32(2.42383598e-7)


def padded(weight: Tensor) -> NDArray[np.float32]:
    """Return a weight (O, I) with zero columns up to a multiple of `UNITS`."""
    return as_array(torch.nn.functional.pad(weight, (0, -weight.shape[1] % UNITS)))


def as_array(values: Tensor) -> NDArray[np.float32]:
    """Return the values of a tensor as a contiguous float32 array."""
    array: NDArray[np.float32] = values.detach().float().contiguous().numpy()
    return array


@njit(cache=True, error_model="numpy")
def rounded_up(number: int, multiple: int) -> Any:
    """Return the least multiple that is not below a number."""
    return -(-number // multiple) * multiple


@njit(cache=True, error_model="numpy")
def row_length(columns: int) -> Any:
    """Return a length of rows for this number of columns that is no power of two.

    Rows a power of two apart would compete for the same few cache lines.
    """
    return rounded_up(columns, LANES) | LANES


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_units(weight: Any, columns: Any, out: Any) -> None:
    """Add weight (I,) times columns (I, E) to out (E,); I is a multiple of `UNITS`."""
    for i in range(0, len(weight), UNITS):
        a, b, c, d = weight[i], weight[i + 1], weight[i + 2], weight[i + 3]
        f, g, h, j = weight[i + 4], weight[i + 5], weight[i + 6], weight[i + 7]
        col_a, col_b, col_c, col_d = columns[i], columns[i + 1], columns[i + 2], columns[i + 3]
        col_f, col_g, col_h, col_j = columns[i + 4], columns[i + 5], columns[i + 6], columns[i + 7]
        for e in range(len(out)):
            low = a * col_a[e] + b * col_b[e] + c * col_c[e] + d * col_d[e]
            high = f * col_f[e] + g * col_g[e] + h * col_h[e] + j * col_j[e]
            out[e] += low + high


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def tanh(x: Any) -> Any:
    """Return tanh of a float32 with an error below 5e-7; NaN stays NaN.

    Plain arithmetic, about 16 operations, so that a loop over it can be vectorized.
    """
    # In this order a comparison keeps NaN.
    x = _END if x > _END else x
    x = -_END if x < -_END else x
    t = x * x
    above = x * (_P0 + t * (_P1 + t * (_P2 + t * _P3)))
    below = np.float32(1.0) + t * (_Q1 + t * (_Q2 + t * (_Q3 + t * _Q4)))
    return above / below


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def apply_tanh(values: Any) -> None:
    """Apply tanh in place, (E,)."""
    for e in range(len(values)):
        values[e] = tanh(values[e])


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def mean(values: Any) -> Any:
    """Return the mean of (E,), summed in any order."""
    total = np.float32(0.0)
    for e in range(len(values)):
        total += values[e]
    return total / np.float32(len(values))
