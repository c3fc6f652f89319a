"""Linear layers with a tanh between them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, final

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor, nn

from fluidsnet.features.dense import (
    UNITS,
    add_units,
    as_array,
    compiled_path_for,
    padded,
    rounded_up,
    squash,
)
from fluidsnet.features.float32_linear import Float32Linear
from fluidsnet.neighbors.threads import take_threads

# Rows a thread sends through all layers at a time: their numbers stay in the first cache.
_ROWS = 160


@final
class Perceptron(nn.ModuleList):
    """Linear layers, tanh after each but the last (the paper's FCN).

    The first, which is fed with places, and the last, which gives the motion, are precise.
    Without gradients on the CPU, rows go through all layers in blocks that stay in the cache,
    with a tanh that is off by 5e-7 at most.

    Args:
        widths: in, of each layer in between, and out.
    """

    def __init__(self, widths: Sequence[int]) -> None:
        layers: list[nn.Module] = []
        for number, (before, after) in enumerate(pairwise(widths)):
            outer = number in (0, len(widths) - 2)
            layers += [(Float32Linear if outer else nn.Linear)(before, after), nn.Tanh()]
        super().__init__(layers[:-1])
        self.widths = tuple(widths)

    def forward(self, own: Tensor, context: Tensor) -> Tensor:
        """(N, last width) from (N, A) and (N, B), side by side the first width.

        Args:
            own: of each row.
            context: of each row; where it is one row expanded, what the first layer makes of
                it is found once.
        """
        if not compiled_path_for(own):
            rows = torch.cat([own, context], dim=1)
            for layer in self:
                rows = layer(rows)
            return rows
        with torch.autocast(own.device.type, enabled=False):
            return self._compiled(own, context)

    def _compiled(self, own: Tensor, context: Tensor) -> Tensor:
        linear = [layer for layer in self if isinstance(layer, nn.Linear)]
        weights: list[Tensor] = [layer.weight for layer in linear]
        biases: list[Tensor] = [layer.bias for layer in linear]
        if len(own) and context.stride(0) == 0:
            biases[0] = nn.functional.linear(context[0], weights[0][:, own.shape[1] :], biases[0])
            weights[0] = weights[0][:, : own.shape[1]]
        else:
            own = torch.cat([own, context], dim=1)
        result = np.empty((len(own), self.widths[-1]), np.float32)
        take_threads(len(own))
        _through(
            as_array(own),
            np.array([own.shape[1], *self.widths[1:]]),
            np.concatenate([padded(weight).ravel() for weight in weights]),
            np.concatenate([as_array(bias) for bias in biases]),
            result,
        )
        return torch.from_numpy(result)


@njit(cache=True, parallel=True, error_model="numpy")
def _through(rows: Any, widths: Any, weights: Any, biases: Any, result: Any) -> None:
    """Sends rows (N, widths[0]) through the layers, whose weights lie one after another."""
    widest = rounded_up(widths.max(), UNITS)
    for block in prange((len(rows) + _ROWS - 1) // _ROWS):
        columns, out = np.zeros((widest, _ROWS), np.float32), np.zeros((widest, _ROWS), np.float32)
        first = block * _ROWS
        number = min(_ROWS, len(rows) - first)
        for i in range(number):
            for unit in range(widths[0]):
                columns[unit, i] = rows[first + i, unit]
        at, bias = 0, 0
        for layer in range(len(widths) - 1):
            inputs = rounded_up(widths[layer], UNITS)
            for unit in range(widths[layer + 1]):
                out[unit] = biases[bias]
                add_units(weights[at : at + inputs], columns, out[unit])
                if layer < len(widths) - 2:
                    squash(out[unit])
                at += inputs
                bias += 1
            # What fills up the next layer's inputs is zero, or nothing times infinity were NaN.
            out[widths[layer + 1] : rounded_up(widths[layer + 1], UNITS)] = 0
            columns, out = out, columns
        for i in range(number):
            for unit in range(widths[-1]):
                result[first + i, unit] = columns[unit, i]
