"""The network of the paper's figure 2, composed from its blocks; plain torch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

import torch
from torch import Tensor, nn
from torch.profiler import record_function

from fluidsnet.features.global_feature import GlobalFeature
from fluidsnet.features.input import InputFeature
from fluidsnet.features.local import LocalFeature
from fluidsnet.features.perceptron import Perceptron
from fluidsnet.features.voxel import GridShape
from fluidsnet.neighbors.search import NeighborSearch
from fluidsnet.particles import Particles
from fluidsnet.statistics import Statistics
from fluidsnet.target import Motion, Target

#: Builds a global feature for a grid and a width of the particles' features.
GlobalFeatureFactory = Callable[[GridShape, int], GlobalFeature]


@final
class Network(nn.Module):
    """Input, local and global features of a particle, and a head that predicts its target.

    Args:
        grid_shape: of the background grid along x, y, z.
        neighbors: search for the nearest neighbors.
        inputs: input feature (section 4.2).
        local: feature of the neighborhood (section 4.3).
        global_feature: makes the feature of the whole scene (sections 4.4 and 4.5).
        target: what the head predicts.
        head: widths between the features and the target (section 4.6; Table 1: 32, 16, 8).
    """

    def __init__(
        self,
        grid_shape: GridShape,
        neighbors: NeighborSearch,
        inputs: InputFeature,
        local: LocalFeature,
        global_feature: GlobalFeatureFactory,
        target: Target,
        head: Sequence[int] = (32, 16, 8),
    ) -> None:
        super().__init__()
        self.grid_shape = grid_shape
        self.neighbors = neighbors
        self.inputs = inputs
        self.local = local
        width = self.inputs.width + local.width
        self.global_feature = global_feature(grid_shape, width)
        self.target = target
        self.head = Perceptron((width + self.global_feature.width, *head, target.width))

    def set_statistics(self, statistics: Statistics) -> None:
        """Takes the scale of inputs and target from the training split."""
        self.inputs.set_statistics(statistics)
        self.target.set_statistics(statistics)

    def forward(self, particles: Particles, global_feature: Tensor | None = None) -> Tensor:
        """The head's output (N, target.width) for the fluid particles.

        A profiler sees its stages as ranges: `search` and `local`, or where no edge is stored
        `sort` and `search + local`; `voxel` and `global`, of the global vector; `head`.

        Args:
            particles: N fluid particles and the solid ones.
            global_feature: (N, global_feature.width) in place of their own.
        """
        features = self.features(particles)
        if global_feature is None:
            global_feature = self.global_feature(particles, features)
        with record_function("head"):
            output: Tensor = self.head(features, global_feature)
        return output

    def features(self, particles: Particles) -> Tensor:
        """Concatenated input and local features of the fluid particles, (N, A)."""
        local = self.local.without_edges(particles, self.neighbors, self.inputs)
        if local is None:
            with record_function("search"):
                neighbors = self.neighbors(particles)
            with record_function("local"):
                local = self.local(particles, neighbors, self.inputs)
        return torch.cat([self.inputs(particles), local], dim=1)

    def motion(self, particles: Particles, global_feature: Tensor | None = None) -> Motion:
        """The predicted motion of the fluid particles over one step; `global_feature` as above."""
        return self.target.decode(self(particles, global_feature), particles)
