"""Layers and means of the voxel feature in one pass over the cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from fluidsnet.kernels.columns import (
    UNITS,
    Layer,
    add_units,
    apply_tanh,
    as_array,
    mean,
    padded,
    rounded_up,
    row_length,
)
from fluidsnet.kernels.threads import set_threads

# Particles per block; more where a cell has more, since cells stay whole.
_PARTICLES = 512


def voxel_means(features: Tensor, order: Tensor, offset: Tensor, layers: Sequence[Layer]) -> Tensor:
    """Return the last layer's means over cells, twice side by side, (C, 2·O).

    A layer is linear, then tanh. Its inputs are a particle's output of the layer before and,
    except in the first layer, the mean of that output over the particle's cell.

    Args:
        features: (N, inputs) float32.
        order: (N,) rows of the particles, sorted by cell.
        offset: (C + 1,) first particle of each cell in `order`.
        layers: Weight (O, I) and bias; I is twice the O of the layer before, except in the first.
    """
    widths = [features.shape[1], *(len(bias) for _, bias in layers)]
    pairs = list(zip(layers, widths, strict=False))
    result = np.empty((len(offset) - 1, 2 * widths[-1]), np.float32)
    set_threads(len(order))
    _forward(
        as_array(features),
        order.numpy(),
        offset.numpy(),
        np.array(widths),
        np.concatenate([padded(weight[:, :width]).ravel() for (weight, _), width in pairs]),
        np.concatenate([padded(weight[:, width:]).ravel() for (weight, _), width in pairs]),
        as_array(torch.cat([bias for _, bias in layers])),
        result,
    )
    return torch.from_numpy(result)


@njit(cache=True, parallel=True, error_model="numpy")
def _forward(
    features: Any, order: Any, offset: Any, widths: Any, own: Any, shared: Any, biases: Any,
    result: Any,
) -> None:  # fmt: skip
    """Write `voxel_means`; the weights and biases of the layers are concatenated."""
    # Only means are kept of the last layer, so it may be wider than the buffers of particles.
    cells, layers = len(result), len(widths) - 1
    widest: Any = rounded_up(widths[:-1].max(), UNITS)
    for block in prange((len(order) + _PARTICLES - 1) // _PARTICLES):
        # All particles of the cells that begin in the block.
        first: Any = np.searchsorted(offset[:cells], block * _PARTICLES)
        last: Any = np.searchsorted(offset[:cells], (block + 1) * _PARTICLES)
        if first == last:
            continue
        begin = offset[first : last + 1] - offset[first]
        rows = order[offset[first] : offset[last]]
        wide = row_length(len(rows))
        columns, out = np.zeros((widest, wide), np.float32), np.zeros((widest, wide), np.float32)
        few = row_length(last - first)
        most = max(widest, widths[-1])
        means, next_means = np.zeros((most, few), np.float32), np.zeros((most, few), np.float32)
        per_cell = np.empty(few, np.float32)
        for i in range(len(rows)):
            for unit in range(widths[0]):
                columns[unit, i] = features[rows[i], unit]
        at, at_shared, bias = 0, 0, 0
        for layer in range(layers):
            inputs, filled = rounded_up(widths[layer], UNITS), widths[layer + 1]
            for unit in range(filled):
                per_cell[:] = biases[bias]
                if layer > 0:
                    add_units(shared[at_shared : at_shared + inputs], means, per_cell)
                    at_shared += inputs
                values = out[unit if layer < layers - 1 else 0]
                for c in range(last - first):
                    values[begin[c] : begin[c + 1]] = per_cell[c]
                add_units(own[at : at + inputs], columns, values)
                apply_tanh(values)
                for c in range(last - first):
                    next_means[unit, c] = mean(values[begin[c] : begin[c + 1]])
                at += inputs
                bias += 1
            # Padding of the next layer's inputs is zero: its weight 0 times infinity would be NaN.
            out[filled : min(rounded_up(filled, UNITS), widest)] = 0
            next_means[filled : rounded_up(filled, UNITS)] = 0
            columns, out = out, columns
            means, next_means = next_means, means
        for c in range(last - first):
            for unit in range(widths[-1]):
                result[first + c, unit] = means[unit, c]
                result[first + c, widths[-1] + unit] = means[unit, c]
