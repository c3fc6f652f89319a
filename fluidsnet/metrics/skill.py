"""`skill`: how much better than the better of the two trivial predictors."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor
from torchmetrics import Metric

from fluidsnet.metrics.frame_mean import frame_means
from fluidsnet.metrics.velocity_mse import squared_error
from fluidsnet.particles import Particles
from fluidsnet.trivial import ballistic, constant_velocity


@final
class Skill(Metric):
    """1 - velocity_mse / the smaller velocity_mse of constant velocity and ballistic.

    0 is no better than doing nothing, 1 is perfect, and there is no lower bound.
    """

    full_state_update = False

    totals: Tensor

    def __init__(self) -> None:
        super().__init__()
        # Of the prediction, of constant velocity, of ballistic, on the same frames.
        self.add_state("totals", torch.zeros(3, dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, predicted: Tensor, true: Tensor, particles: Particles) -> None:
        """Adds a batch.

        Args:
            predicted: (N, 3) velocities one step later, m/s.
            true: (N, 3) as the data have them, m/s.
            particles: the true state that the prediction was made from.
        """
        guesses = (
            predicted,
            constant_velocity(particles).velocity,
            ballistic(particles).velocity,
        )
        self.totals += torch.stack(
            [frame_means(squared_error(guess, true), particles).sum() for guess in guesses]
        )

    def compute(self) -> Tensor:
        """The skill over the frames so far."""
        return (1 - self.totals[0] / self.totals[1:].min()).float()
