"""Noise on the states a network is trained on, so that it learns to mend its own errors."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fluidsnet.particles import Particles
from fluidsnet.statistics import Statistics


class StartNoise(nn.Module):
    """Disturbs the start of a transition; where it ends stays true.

    Each frame gets normal noise of its own strength, drawn evenly from none up to `most`.

    Args:
        most: greatest deviation, in units of the training split's own deviations of
            velocity change and drift over a step.
    """

    change_deviation: Tensor
    drift_deviation: Tensor

    def __init__(self, most: float = 0.5) -> None:
        super().__init__()
        self.most = most
        self.register_buffer("change_deviation", torch.ones(()), persistent=False)
        self.register_buffer("drift_deviation", torch.ones(()), persistent=False)

    def set_statistics(self, statistics: Statistics) -> None:
        """Takes the scale of the noise from the training split."""
        self.change_deviation.copy_(statistics.change_deviation)
        self.drift_deviation.copy_(statistics.drift_deviation)

    def forward(self, particles: Particles) -> Particles:
        """The disturbed state."""
        strength = particles.position.new_empty(particles.frames, 1).uniform_(0, self.most)
        strength = strength[particles.frame]
        return particles.moved(
            particles.position
            + strength * self.drift_deviation * torch.randn_like(particles.position),
            particles.velocity
            + strength * self.change_deviation * torch.randn_like(particles.velocity),
        )
