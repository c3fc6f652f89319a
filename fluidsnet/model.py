"""A network with what makes steps of its motion, and what it is trained to; plain torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn

from fluidsnet.errors import UserError
from fluidsnet.features.global_feature import GlobalVector
from fluidsnet.features.local import LocalFeature, NeighborMean
from fluidsnet.features.voxel import GridShape
from fluidsnet.integrator import Euler, Integrator
from fluidsnet.loss import mean_square
from fluidsnet.neighbors import Auto, NeighborSearch
from fluidsnet.network import GlobalFeatureFactory, Network
from fluidsnet.noise import StartNoise
from fluidsnet.particles import Particles, Transitions
from fluidsnet.rng import preserve_rng_state
from fluidsnet.statistics import Statistics
from fluidsnet.target import Target, VelocityTarget
from fluidsnet.walls import OpenWalls, Walls


class Model(nn.Module):
    """From a state to the next; `FluidsNet` is one that Lightning trains.

    Args:
        grid_shape: of the background grid along x, y and z.
        neighbors: search for neighbors; `Auto` by default.
        local: local feature; `NeighborMean` by default.
        global_feature: makes the feature of the whole scene; `GlobalVector` by default.
        target: what is predicted; `VelocityTarget` by default.
        integrator: from velocity to position; `Euler` by default.
        walls: what happens at the domain's border; `OpenWalls` by default.
        head: widths of the layers before the last.
        noise: on the states trained on; none by default.

    Raises:
        UserError: the integrator needs what the target does not give.
    """

    time_step: Tensor

    def __init__(
        self,
        grid_shape: GridShape,
        neighbors: NeighborSearch | None = None,
        local: LocalFeature | None = None,
        global_feature: GlobalFeatureFactory | None = None,
        target: Target | None = None,
        integrator: Integrator | None = None,
        walls: Walls | None = None,
        head: Sequence[int] = (32, 16, 8),
        noise: StartNoise | None = None,
    ) -> None:
        super().__init__()
        self._context, self._head = global_feature or GlobalVector, head
        self.network = Network(
            grid_shape=grid_shape,
            neighbors=neighbors or Auto(),
            local=local or NeighborMean(),
            global_feature=self._context,
            target=target or VelocityTarget(),
            head=head,
        )
        self.integrator = integrator or Euler()
        self.walls = walls or OpenWalls()
        self.noise = noise
        # Part of the checkpoint, so that a network never runs at a step it was not trained on.
        self.register_buffer("time_step", torch.zeros((), dtype=torch.float64))
        if self.integrator.needs_displacement and not self.network.target.gives_displacement:
            raise UserError(
                f"The integrator {type(self.integrator).__name__} needs a target that predicts "
                f"a displacement, and {type(self.network.target).__name__} does not; use "
                "DisplacementTarget, or the integrator Euler or Trapezoid."
            )

    def set_statistics(self, statistics: Statistics, time_step: float) -> None:
        """Takes the scale of inputs and target, and the time step in s, from the training data."""
        self.network.set_statistics(statistics)
        if self.noise is not None:
            self.noise.set_statistics(statistics)
        self.time_step.fill_(time_step)

    def forward(self, particles: Particles, global_feature: Tensor | None = None) -> Particles:
        """The predicted state one step later; `global_feature` as `Network` takes it."""
        return self.walls(
            self.integrator(particles, self.network.motion(particles, global_feature))
        )

    def loss(self, batch: Transitions) -> Tensor:
        """The mean squared error of the head's output, over as many steps as the batch has, ()."""
        state = batch.state if self.noise is None else self.noise(batch.state)
        losses = []
        for position, velocity in zip(batch.next_position, batch.next_velocity, strict=True):
            output = self.network(state)
            expected = self.network.target.encode(state, position, velocity)
            losses.append(mean_square(output, expected))
            if len(losses) < len(batch.next_position):
                motion = self.network.target.decode(output, state)
                state = self.walls(self.integrator(state, motion))
        return torch.stack(losses).mean()

    def blocks(self) -> dict[str, Any]:
        """The blocks as built, by the names that the constructor gives them."""
        network = self.network
        return {
            "neighbors": network.neighbors,
            "local": network.local,
            "global_feature": network.global_feature,
            "target": network.target,
            "integrator": self.integrator,
            "walls": self.walls,
            "head": network.head,
            "noise": self.noise,
        }

    def twin(self, changes: Mapping[str, Any] | None = None) -> Model:
        """Another model with blocks of its own, alike but for what is changed.

        Weights whose names and shapes agree are equal. The others are drawn, which leaves no
        trace in the random numbers that follow.

        Args:
            changes: other arguments of the constructor, by their names.
        """
        made_elsewhere = {"global_feature": self._context, "head": self._head}
        kept = {name: block for name, block in self.blocks().items() if name not in made_elsewhere}
        with preserve_rng_state():
            twin = Model(
                **{
                    "grid_shape": self.network.grid_shape,
                    **made_elsewhere,
                    **deepcopy(kept),
                    **(changes or {}),
                }
            )
        own, mine = twin.state_dict(), self.state_dict()
        shared = [name for name in own if name in mine and own[name].shape == mine[name].shape]
        twin.load_state_dict({name: mine[name] for name in shared}, strict=False)
        return twin
