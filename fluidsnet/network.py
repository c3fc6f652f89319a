"""Network composed from its blocks (paper, figure 2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

import torch
from torch import Tensor, nn
from torch.profiler import record_function

from fluidsnet.errors import UserError
from fluidsnet.features.fused_local import fused_local
from fluidsnet.features.global_feature import GlobalFeature
from fluidsnet.features.input import InputFeature
from fluidsnet.features.local import LocalFeature
from fluidsnet.features.perceptron import Perceptron
from fluidsnet.features.voxel import GridShape
from fluidsnet.neighbors.reach import within_reach
from fluidsnet.neighbors.search import NeighborSearch
from fluidsnet.particles import Particles
from fluidsnet.statistics import Statistics
from fluidsnet.target import Target

#: Builds a global feature for a grid shape and a width of the particles' features.
GlobalFeatureFactory = Callable[[GridShape, int], GlobalFeature]


@final
class Network(nn.Module):
    """Input, local and global features of a particle, and a head that predicts the target.

    Args:
        grid_shape: Number of cells of the background grid along x, y, z.
        neighbors: Neighbor search.
        inputs: Input feature (section 4.2).
        local: Feature of the neighborhood (section 4.3).
        global_feature: Builds the feature of the whole scene (sections 4.4 and 4.5).
        target: Quantity that the head predicts.
        head: Widths of the head's hidden layers (section 4.6; Table 1: 32, 16, 8).

    Raises:
        UserError: The local feature expects other columns than the input feature sends.
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
        for name in ("sent_width", "relative_width"):
            expected, given = getattr(local, name), getattr(inputs, name)
            if expected not in (None, given):
                raise UserError(
                    f"{type(local).__name__} expects {name} {expected}, and the input feature "
                    f"{type(inputs).__name__} has {given}; set local.init_args.{name} to {given}."
                )
        self.grid_shape = grid_shape
        self.neighbors = neighbors
        self.inputs = inputs
        self.local = local
        width = self.inputs.width + local.width
        self.global_feature = global_feature(grid_shape, width)
        self.target = target
        self.head = Perceptron((width + self.global_feature.width, *head, target.width))

    def set_statistics(self, statistics: Statistics) -> None:
        """Set the normalization of inputs and target from the training split."""
        self.inputs.set_statistics(statistics)
        self.target.set_statistics(statistics)

    def forward(self, particles: Particles, global_feature: Tensor | None = None) -> Tensor:
        """Return the head's output (N, target.width) for the fluid particles.

        Profiler ranges of the stages: `search` and `local`, or `sort` and `search + local` where
        one kernel does both; `voxel` and `global` of the global vector; `head`.

        Args:
            particles: N fluid particles and the solid ones.
            global_feature: (N, global_feature.width) that replaces the state's own.
        """
        features = self.features(particles)
        if global_feature is None:
            global_feature = self.global_feature(particles, features)
        with record_function("head"):
            output: Tensor = self.head(features, global_feature)
        return output

    def features(self, particles: Particles) -> Tensor:
        """Return the input and local features of the fluid particles, (N, A)."""
        local = fused_local(particles, self.neighbors, self.local, self.inputs)
        if local is None:
            with record_function("search"):
                reached, neighbors = within_reach(particles, self.neighbors(particles))
            with record_function("local"):
                local = self.local(reached, neighbors, self.inputs)
        return torch.cat([self.inputs(particles), local], dim=1)
