"""Input feature of a particle (paper, section 4.2)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.particles import Particles
from fluidsnet.priors.prior import Guess
from fluidsnet.statistics import Residuals, Statistics

#: Marker s/f of fluid and solid particles.
FLUID, SOLID = 0.0, 1.0


class InputFeature(nn.Module, ABC):
    """Normalized columns of a particle: its own, and those it sends to its neighbors.

    Attributes:
        width: Number of columns of `forward`.
        sent_width: Number of columns of `sent`.
        relative_width: Number of leading columns of `sent` that a receiver may subtract its
            own from, such as the velocity.
        reads_guess: `forward` uses the prior's guess.
        reads_description: The guess must have columns, see `Prior.describes`.
    """

    width: int
    sent_width: int
    relative_width: int
    reads_guess: bool = True
    reads_description: bool = False

    @abstractmethod
    def set_statistics(self, statistics: Statistics) -> None:
        """Set the normalization from the training split."""

    def set_residuals(self, residuals: Residuals) -> None:
        """Set the normalization by what the prior leaves; by default there is none."""

    @abstractmethod
    def forward(self, particles: Particles, guess: Guess) -> Tensor:
        """Return the input feature (N, width) of the fluid particles.

        Args:
            particles: State.
            guess: State one step later by the prior.
        """

    @abstractmethod
    def sent(self, particles: Particles) -> Tensor:
        """Return what fluid and solid particles send to neighbors, (N + M, sent_width).

        The offset to the neighbor is not part of it; local features add it.
        """


@final
class ParticleState(InputFeature):
    r"""The paper's seven columns [x, y, z, u, v, w, s/f]; a neighbor sends [u, v, w, s/f].

    Positions run from -1 to 1 along each axis of the domain, so that a scaled scene has the
    same features. Velocities are divided by their deviation :math:`\sigma_v` in the training
    split. The marker s/f is 0 for fluid and 1 for solids.
    """

    width = 7
    sent_width = 4
    relative_width = 3
    reads_guess = False

    velocity_deviation: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("velocity_deviation", torch.ones(()))

    def set_statistics(self, statistics: Statistics) -> None:
        self.velocity_deviation.copy_(statistics.velocity_deviation)

    def forward(self, particles: Particles, guess: Guess) -> Tensor:
        scene = particles.scene
        lower, extent = map(particles.per_particle, (scene.domain_lower, scene.extent))
        position = 2 * (particles.position - lower) / extent - 1
        marker = position.new_full((len(position), 1), FLUID)
        return torch.cat([position, particles.velocity / self.velocity_deviation, marker], dim=1)

    def sent(self, particles: Particles) -> Tensor:
        velocity = torch.cat([particles.velocity, particles.solid_velocity])
        marker = velocity.new_full((len(velocity), 1), SOLID)
        marker[: len(particles)] = FLUID
        if particles.fluid_image is not None:
            marker[len(particles) :][particles.fluid_image] = FLUID
        return torch.cat([velocity / self.velocity_deviation, marker], dim=1)
