"""Input feature of a prior that knows pressure."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.features.input import FLUID, SOLID, InputFeature
from fluidsnet.particles import Particles
from fluidsnet.priors.columns import WIDTH
from fluidsnet.priors.prior import Guess
from fluidsnet.statistics import Residuals, Statistics

#: Added to deviations, so that a column that hardly varies is not blown up.
_LEAST = 1e-3


@final
class PriorState(InputFeature):
    r"""The prior's velocity and its change, distances to the walls, and the prior's columns.

    34 columns: :math:`\hat v / \sigma_v`; :math:`(\hat v - v - Δt·g) / \sigma_v`; the distances to
    the six walls in support radii, at most two; and the 22 columns of `join_columns`, each less
    its mean and over its deviation in the training split. A neighbor sends
    [:math:`v / \sigma_v`, s/f] as in `ParticleState`.
    """

    width = 12 + WIDTH
    sent_width = 4
    relative_width = 3
    reads_description = True

    velocity_deviation: Tensor
    column_mean: Tensor
    column_deviation: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("velocity_deviation", torch.ones(()))
        self.register_buffer("column_mean", torch.zeros(WIDTH))
        self.register_buffer("column_deviation", torch.ones(WIDTH))

    def set_statistics(self, statistics: Statistics) -> None:
        self.velocity_deviation.copy_(statistics.velocity_deviation)

    def set_residuals(self, residuals: Residuals) -> None:
        self.column_mean.copy_(residuals.column_mean)
        self.column_deviation.copy_(residuals.column_deviation + _LEAST)

    def forward(self, particles: Particles, guess: Guess) -> Tensor:
        assert guess.columns is not None
        scene = particles.scene
        lower, upper, gravity = map(
            particles.per_particle, (scene.domain_lower, scene.domain_upper, scene.gravity)
        )
        walls = torch.cat([guess.position - lower, upper - guess.position], dim=1)
        change = guess.velocity - particles.velocity - scene.time_step * gravity
        columns = (guess.columns - self.column_mean) / self.column_deviation
        return torch.cat(
            [
                guess.velocity / self.velocity_deviation,
                change / self.velocity_deviation,
                (walls / scene.support_radius).clamp(-2, 2),
                columns.clamp(-10, 10),
            ],
            dim=1,
        )

    def sent(self, particles: Particles) -> Tensor:
        velocity = torch.cat([particles.velocity, particles.solid_velocity])
        marker = velocity.new_full((len(velocity), 1), SOLID)
        marker[: len(particles)] = FLUID
        return torch.cat([velocity / self.velocity_deviation, marker], dim=1)
