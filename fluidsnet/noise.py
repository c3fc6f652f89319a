"""Noise on training states, so that a network learns to correct errors of a rollout."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fluidsnet.particles import Particles
from fluidsnet.statistics import Residuals, Statistics


class StartNoise(nn.Module):
    """Add normal noise to the start of a transition; the next state is not changed.

    The strength is drawn for each frame from the uniform distribution on [0, `most`].

    Args:
        most: Maximum strength, in deviations of velocity change and drift over a step in the
            training split; with a prior that knows pressure, in deviations of what it leaves.
    """

    change_deviation: Tensor
    drift_deviation: Tensor

    def __init__(self, most: float = 0.5) -> None:
        super().__init__()
        self.most = most
        self.register_buffer("change_deviation", torch.ones(()), persistent=False)
        self.register_buffer("drift_deviation", torch.ones(()), persistent=False)

    def set_statistics(self, statistics: Statistics) -> None:
        """Set the scale of the noise from the training split."""
        self.change_deviation.copy_(statistics.change_deviation)
        self.drift_deviation.copy_(statistics.drift_deviation)

    def set_residuals(self, residuals: Residuals) -> None:
        """Set the scale of the noise by what the prior leaves."""
        self.change_deviation.copy_(residuals.change_deviation)
        self.drift_deviation.copy_(residuals.drift_deviation)

    def forward(self, particles: Particles) -> Particles:
        """Return the state with noise, whose strength is drawn for each frame."""
        strength = particles.position.new_empty(particles.frames, 1).uniform_(0, self.most)
        strength = strength[particles.frame]
        drift = self.drift_deviation * particles.scene.support_radius
        shift, turn = (torch.randn_like(it) for it in (particles.position, particles.velocity))
        # In two dimensions the third coordinate does not change.
        shift[:, particles.scene.dimension :] = turn[:, particles.scene.dimension :] = 0
        return particles.moved(
            particles.position + strength * drift * shift,
            particles.velocity + strength * self.change_deviation * turn,
        )
