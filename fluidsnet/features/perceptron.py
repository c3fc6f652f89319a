"""Perceptron: linear layers with tanh between them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.features.float32_linear import Float32Linear
from fluidsnet.kernels import use_kernel
from fluidsnet.kernels.perceptron import perceptron


@final
class Perceptron(nn.ModuleList):
    """Linear layers with tanh after each but the last (the paper's FCN).

    The first layer, which gets positions, and the last, which gives the motion, stay in float32
    under mixed precision.

    Args:
        widths: Widths of the input, of each hidden layer and of the output.
    """

    def __init__(self, widths: Sequence[int]) -> None:
        layers: list[nn.Module] = []
        for index, (inputs, outputs) in enumerate(pairwise(widths)):
            outer = index in (0, len(widths) - 2)
            layers += [(Float32Linear if outer else nn.Linear)(inputs, outputs), nn.Tanh()]
        super().__init__(layers[:-1])
        self.widths = tuple(widths)

    def forward(self, own: Tensor, shared: Tensor) -> Tensor:
        """Return the output (N, O) for rows [own, shared].

        Args:
            own: (N, A).
            shared: (N, B); one row may be expanded to all.
        """
        if use_kernel(self, own, shared):
            return perceptron(own, shared, linear_layers(self))
        rows = torch.cat([own, shared], dim=1)
        for layer in self:
            rows = layer(rows)
        return rows


def linear_layers(layers: nn.Module) -> list[tuple[Tensor, Tensor]]:
    """Return weight (O, I) and bias (O,) of the linear layers in a module."""
    return [
        (layer.weight, layer.bias) for layer in layers.children() if isinstance(layer, nn.Linear)
    ]
