"""Network composed from its blocks (paper, figure 2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

import torch
from torch import Tensor, nn
from torch.nn.functional import pad
from torch.profiler import record_function

from fluidsnet.errors import UserError
from fluidsnet.features.fused_local import fused_local
from fluidsnet.features.global_feature import GlobalFeature
from fluidsnet.features.input import InputFeature
from fluidsnet.features.local import LocalFeature
from fluidsnet.features.perceptron import Perceptron
from fluidsnet.features.scene_inputs import SceneInputs
from fluidsnet.features.voxel import GridShape
from fluidsnet.neighbors.reach import within_reach
from fluidsnet.neighbors.search import NeighborSearch
from fluidsnet.particles import Particles
from fluidsnet.periodic import with_images, wrapped
from fluidsnet.priors.prior import Guess
from fluidsnet.statistics import Residuals, Statistics
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
        scene_inputs: Values of the scene that are an input; none by default.
        dimension: Dimensions of the scenes; in two, the head has no output along the third axis.

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
        scene_inputs: SceneInputs | None = None,
        dimension: int = 3,
    ) -> None:
        super().__init__()
        for name, of_input in (
            ("input_width", "width"),
            ("sent_width", "sent_width"),
            ("relative_width", "relative_width"),
        ):
            expected, given = getattr(local, name), getattr(inputs, of_input)
            if expected not in (None, given):
                raise UserError(
                    f"{type(local).__name__} expects {name} {expected}, and the input feature "
                    f"{type(inputs).__name__} has {given}; set local.init_args.{name} to {given}."
                )
        self.grid_shape = grid_shape
        self.neighbors = neighbors
        self.inputs = inputs
        self.local = local
        self.scene_inputs = scene_inputs or SceneInputs()
        width = self.inputs.width + local.width + self.scene_inputs.width
        self.global_feature = global_feature(grid_shape, width)
        self.target = target
        # A target without columns has no output to compute.
        self.dimension = dimension
        outputs = target.width // 3 * dimension
        widths = (width + self.global_feature.width, *head, outputs)
        self.head = Perceptron(widths if target.width else ())

    @property
    def reads_guess(self) -> bool:
        """Return whether a block uses the prior's guess."""
        return self.target.reads_guess or self.inputs.reads_guess or self.local.at_guess

    @property
    def reads_description(self) -> bool:
        """Return whether a block needs neighbors and columns of the prior."""
        return self.target.width > 0 and (self.local.at_guess or self.inputs.reads_description)

    def set_statistics(self, statistics: Statistics) -> None:
        """Set the normalization of inputs and target from the training split."""
        self.inputs.set_statistics(statistics)
        self.scene_inputs.set_range(statistics.least, statistics.greatest)
        self.target.set_statistics(statistics)

    def set_residuals(self, residuals: Residuals) -> None:
        """Set the normalization of inputs and target by what the prior leaves."""
        self.inputs.set_residuals(residuals)
        self.target.set_residuals(residuals)

    def forward(
        self, particles: Particles, guess: Guess, global_feature: Tensor | None = None
    ) -> Tensor:
        """Return the head's output (N, target.width) for the fluid particles.

        Profiler ranges of the stages: `search` and `local`, or `sort` and `search + local` where
        one kernel does both; `voxel` and `global` of the global vector; `head`.

        Args:
            particles: N fluid particles and the solid ones.
            guess: State one step later by the prior.
            global_feature: (N, global_feature.width) that replaces the state's own.
        """
        if self.target.width == 0:
            return particles.position.new_empty(len(particles), 0)
        particles = wrapped(particles)
        features = self.features(particles, guess)
        if global_feature is None:
            global_feature = self.global_feature(particles, features)
        with record_function("head"):
            output: Tensor = self.head(features, global_feature)
        if self.dimension == 3:
            return output
        # Vectors of two components get a third one.
        return pad(output.view(len(output), -1, self.dimension), (0, 1)).flatten(1)

    def features(self, particles: Particles, guess: Guess) -> Tensor:
        """Return the input and local features of the fluid particles, (N, A).

        Values of the scene that vary follow them.
        """
        columns = self.inputs(particles, guess)
        parts = [columns, self.neighborhood(particles, guess, columns)]
        if self.scene_inputs.width:
            parts.append(self.scene_inputs(particles))
        return torch.cat(parts, dim=1)

    def neighborhood(self, particles: Particles, guess: Guess, columns: Tensor) -> Tensor:
        """Return the local feature of the fluid particles, (N, local.width).

        Args:
            particles: State.
            guess: State one step later by the prior.
            columns: (N, inputs.width) input feature.
        """
        if self.local.at_guess and guess.neighbors is not None:
            with record_function("local"):
                moved = particles.moved(guess.position, guess.velocity)
                at_guess: Tensor = self.local(moved, guess.neighbors, self.inputs, columns)
            return at_guess
        particles = with_images(particles)
        fused = fused_local(particles, self.neighbors, self.local, self.inputs)
        if fused is not None:
            return fused
        with record_function("search"):
            reached, neighbors = within_reach(particles, self.neighbors(particles))
        with record_function("local"):
            local: Tensor = self.local(reached, neighbors, self.inputs, columns)
        return local
