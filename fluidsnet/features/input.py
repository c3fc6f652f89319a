"""The seven numbers of a particle (paper, section 4.2), normalized by the scene."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.particles import Particles
from fluidsnet.statistics import Statistics

#: The marker s/f of fluid and solid particles.
FLUID, SOLID = 0.0, 1.0


@final
class InputFeature(nn.Module):
    """[x, y, z, u, v, w, s/f]: place in the domain, velocity in training deviations, marker.

    The place runs from -1 to 1 along each axis, so that a scene and its scaled copy look
    alike.
    """

    width = 7

    velocity_deviation: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("velocity_deviation", torch.ones(()))

    def set_statistics(self, statistics: Statistics) -> None:
        """Takes the scale of velocities from the training split."""
        self.velocity_deviation.copy_(statistics.velocity_deviation)

    def forward(self, particles: Particles) -> Tensor:
        """The input features (N, 7) of the fluid particles."""
        scene = particles.scene
        place = 2 * (particles.position - scene.domain_lower) / scene.extent - 1
        marker = place.new_full((len(place), 1), FLUID)
        return torch.cat([place, self.scaled(particles.velocity), marker], dim=1)

    def scaled(self, velocity: Tensor) -> Tensor:
        """Velocities, m/s, in units of the training split's deviation."""
        return velocity / self.velocity_deviation
