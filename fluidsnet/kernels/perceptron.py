"""Linear layers with tanh between them, in blocks of rows that stay in the L1 cache."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor
from torch.nn.functional import linear

from fluidsnet.kernels.columns import (
    UNITS,
    Layer,
    add_units,
    apply_tanh,
    as_array,
    padded,
    rounded_up,
)
from fluidsnet.kernels.threads import set_threads

# Rows per block.
_ROWS = 160


def perceptron(own: Tensor, shared: Tensor, layers: Sequence[Layer]) -> Tensor:
    """Return the output (N, O) of the layers; tanh, exact to 5e-7, follows all but the last.

    Args:
        own: (N, A) first inputs of each row.
        shared: (N, B) further inputs; where it is one row expanded, the first layer is applied
            to that row once.
        layers: Linear layers from A + B to O.
    """
    (weight, bias), *rest = layers
    if len(own) and shared.stride(0) == 0:
        with torch.autocast("cpu", enabled=False):
            bias = linear(shared[0], weight[:, own.shape[1] :], bias)
        layers = [(weight[:, : own.shape[1]], bias), *rest]
    else:
        own = torch.cat([own, shared], dim=1)
    widths = [own.shape[1], *(len(bias) for _, bias in layers)]
    result = np.empty((len(own), widths[-1]), np.float32)
    set_threads(len(own))
    _forward(
        as_array(own),
        np.array(widths),
        np.concatenate([padded(weight).ravel() for weight, _ in layers]),
        np.concatenate([as_array(bias) for _, bias in layers]),
        result,
    )
    return torch.from_numpy(result)


@njit(cache=True, parallel=True, error_model="numpy")
def _forward(rows: Any, widths: Any, weights: Any, biases: Any, result: Any) -> None:
    """Write the layers' outputs for rows (N, widths[0]); weights and biases are concatenated."""
    widest = rounded_up(widths.max(), UNITS)
    for block in prange((len(rows) + _ROWS - 1) // _ROWS):
        columns, out = np.zeros((widest, _ROWS), np.float32), np.zeros((widest, _ROWS), np.float32)
        first = block * _ROWS
        count = min(_ROWS, len(rows) - first)
        for i in range(count):
            for unit in range(widths[0]):
                columns[unit, i] = rows[first + i, unit]
        at, bias = 0, 0
        for layer in range(len(widths) - 1):
            inputs = rounded_up(widths[layer], UNITS)
            for unit in range(widths[layer + 1]):
                out[unit] = biases[bias]
                add_units(weights[at : at + inputs], columns, out[unit])
                if layer < len(widths) - 2:
                    apply_tanh(out[unit])
                at += inputs
                bias += 1
            # Padding of the next layer's inputs is zero: its weight 0 times infinity would be NaN.
            out[widths[layer + 1] : rounded_up(widths[layer + 1], UNITS)] = 0
            columns, out = out, columns
        for i in range(count):
            for unit in range(widths[-1]):
                result[first + i, unit] = columns[unit, i]
