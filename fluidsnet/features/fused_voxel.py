"""The voxel feature's layers and means in one pass over the cells on the CPU, compiled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from fluidsnet.features.dense import (
    LANES,
    UNITS,
    add_units,
    as_array,
    mean,
    padded,
    rounded_up,
    squash,
)
from fluidsnet.neighbors.threads import take_threads

# Particles a thread sends through all layers at a time, or more to keep a cell whole.
_PARTICLES = 512


def cell_means(
    features: Tensor, order: Tensor, offset: Tensor, layers: Sequence[tuple[Tensor, Tensor]]
) -> Tensor:
    """Means over cells of the last of several layers, twice side by side: (C, 2·O).

    A layer is linear, then tanh. It takes a particle's own result of the layer before and, but
    for the first, the mean of that over the particle's cell.

    Args:
        features: (N, inputs) float32 of the particles.
        order: (N,) their rows, one cell's after another's.
        offset: (C + 1,) where the cells begin in it.
        layers: weight (O, I) and bias (O,) of each; but for the first, I is twice the O before.
    """
    widths = [features.shape[1], *(len(bias) for _, bias in layers)]
    own = [padded(weight[:, :width]) for (weight, _), width in zip(layers, widths, strict=False)]
    shared = [padded(weight[:, width:]) for (weight, _), width in zip(layers, widths, strict=False)]
    result = np.empty((len(offset) - 1, 2 * widths[-1]), np.float32)
    take_threads(len(order))
    _through(
        as_array(features),
        order.numpy(),
        offset.numpy(),
        np.array(widths),
        np.concatenate([weight.ravel() for weight in own]),
        np.concatenate([weight.ravel() for weight in shared]),
        as_array(torch.cat([bias for _, bias in layers])),
        result,
    )
    return torch.from_numpy(result)


@njit(cache=True, parallel=True, error_model="numpy")
def _through(
    features: Any, order: Any, offset: Any, widths: Any, own: Any, shared: Any, biases: Any,
    result: Any,
) -> None:  # fmt: skip
    """`cell_means` with the layers' weights and biases one after another's."""
    # Of the last layer only the means are kept.
    cells, layers = len(result), len(widths) - 1
    widest: Any = rounded_up(widths[:-1].max(), UNITS)
    for block in prange((len(order) + _PARTICLES - 1) // _PARTICLES):
        # Of the cells that begin in the block, all particles.
        first: Any = np.searchsorted(offset[:cells], block * _PARTICLES)
        last: Any = np.searchsorted(offset[:cells], (block + 1) * _PARTICLES)
        if first == last:
            continue
        begin = offset[first : last + 1] - offset[first]
        rows = order[offset[first] : offset[last]]
        # Not a power of two from row to row, as those share few places in the cache.
        wide = rounded_up(len(rows), LANES) | LANES
        columns, out = np.zeros((widest, wide), np.float32), np.zeros((widest, wide), np.float32)
        few = rounded_up(last - first, LANES) | LANES
        most = max(widest, widths[-1])
        means, next_means = np.zeros((most, few), np.float32), np.zeros((most, few), np.float32)
        of_cells = np.empty(few, np.float32)
        for i in range(len(rows)):
            for unit in range(widths[0]):
                columns[unit, i] = features[rows[i], unit]
        at, at_shared, bias = 0, 0, 0
        for layer in range(layers):
            inputs, filled = rounded_up(widths[layer], UNITS), widths[layer + 1]
            for unit in range(filled):
                of_cells[:] = biases[bias]
                if layer > 0:
                    add_units(shared[at_shared : at_shared + inputs], means, of_cells)
                    at_shared += inputs
                values = out[unit if layer < layers - 1 else 0]
                for c in range(last - first):
                    values[begin[c] : begin[c + 1]] = of_cells[c]
                add_units(own[at : at + inputs], columns, values)
                squash(values)
                for c in range(last - first):
                    next_means[unit, c] = mean(values[begin[c] : begin[c + 1]])
                at += inputs
                bias += 1
            # What fills up the next layer's inputs is zero, or nothing times infinity were NaN.
            out[filled : min(rounded_up(filled, UNITS), widest)] = 0
            next_means[filled : rounded_up(filled, UNITS)] = 0
            columns, out = out, columns
            means, next_means = next_means, means
        for c in range(last - first):
            for unit in range(widths[-1]):
                result[first + c, unit] = means[unit, c]
                result[first + c, widths[-1] + unit] = means[unit, c]
