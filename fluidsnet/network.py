"""The network of the paper's figure 2, composed from its blocks; plain torch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

import torch
from torch import Tensor, nn
from torch.profiler import record_function

from fluidsnet.features.context import Context
from fluidsnet.features.input import InputFeature
from fluidsnet.features.local import LocalFeature
from fluidsnet.features.perceptron import Perceptron
from fluidsnet.features.voxel import GridShape
from fluidsnet.neighbors.search import NeighborSearch
from fluidsnet.particles import Particles
from fluidsnet.statistics import Statistics
from fluidsnet.target import Motion, Target

#: Builds a context for a grid and a width of the particles' features.
ContextFactory = Callable[[GridShape, int], Context]


@final
class Network(nn.Module):
    """Input, local and context features of a particle, and a head that predicts its target.

    Args:
        cells: of the background grid along x, y, z.
        neighbors: search for the nearest neighbors.
        local: feature of the neighborhood (section 4.3).
        context: makes the feature of the whole scene (sections 4.4 and 4.5).
        target: what the head predicts.
        head: widths between the features and the target (section 4.6; Table 1: 32, 16, 8).
    """

    def __init__(
        self,
        cells: GridShape,
        neighbors: NeighborSearch,
        local: LocalFeature,
        context: ContextFactory,
        target: Target,
        head: Sequence[int] = (32, 16, 8),
    ) -> None:
        super().__init__()
        self.cells = cells
        self.neighbors = neighbors
        self.inputs = InputFeature()
        self.local = local
        width = self.inputs.width + local.width
        self.context = context(cells, width)
        self.target = target
        self.head = Perceptron((width + self.context.width, *head, target.width))

    def set_statistics(self, statistics: Statistics) -> None:
        """Takes the scale of inputs and target from the training split."""
        self.inputs.set_statistics(statistics)
        self.target.set_statistics(statistics)

    def forward(self, particles: Particles, context: Tensor | None = None) -> Tensor:
        """The head's output (N, target.width) for the fluid particles.

        A profiler sees its stages as ranges: `search` and `local`, or where no edge is stored
        `sort` and `search + local`; `voxel` and `global`, of the global vector; `head`.

        Args:
            particles: N fluid particles and the solid ones.
            context: (N, context.width) in place of their own.
        """
        features = self.features(particles)
        if context is None:
            context = self.context(particles, features)
        with record_function("head"):
            output: Tensor = self.head(features, context)
        return output

    def features(self, particles: Particles) -> Tensor:
        """Input and local features of the fluid particles, side by side: what the context sees."""
        local = self.local.without_edges(particles, self.neighbors, self.inputs)
        if local is None:
            with record_function("search"):
                neighbors = self.neighbors(particles)
            with record_function("local"):
                local = self.local(particles, neighbors, self.inputs)
        return torch.cat([self.inputs(particles), local], dim=1)

    def motion(self, particles: Particles, context: Tensor | None = None) -> Motion:
        """The predicted motion of the fluid particles over one step; `context` as above."""
        return self.target.decode(self(particles, context), particles)
