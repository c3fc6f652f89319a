"""`skill`: how much better than the better of the two trivial predictors."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from fluidsnet.baselines import ballistic, constant_velocity
from fluidsnet.metrics.frame_mean import frame_means, simulation_mean
from fluidsnet.metrics.velocity_mse import squared_error
from fluidsnet.particles import Particles


@final
class Skill(Metric):
    """1 - velocity_mse / the smaller velocity_mse of constant velocity and ballistic.

    0 is no better than doing nothing, 1 is perfect, and there is no lower bound.
    """

    full_state_update = False

    errors: list[Tensor]
    simulations: list[Tensor]

    def __init__(self) -> None:
        super().__init__()
        # Of the prediction, of constant velocity, of ballistic, on the same frames.
        self.add_state("errors", [], dist_reduce_fx="cat")
        self.add_state("simulations", [], dist_reduce_fx="cat")

    def update(
        self, predicted: Tensor, true: Tensor, particles: Particles, simulation: Tensor
    ) -> None:
        """Adds a batch.

        Args:
            predicted: (N, 3) velocities one step later, m/s.
            true: (N, 3) as the data have them, m/s.
            particles: the true state that the prediction was made from.
            simulation: (F,) int64, which one each frame is of.
        """
        guesses = (
            predicted,
            constant_velocity(particles).velocity,
            ballistic(particles).velocity,
        )
        errors = [frame_means(squared_error(guess, true), particles) for guess in guesses]
        self.errors.append(torch.stack(errors, dim=1))
        self.simulations.append(simulation)

    def compute(self) -> Tensor:
        """The skill over the frames so far."""
        means = simulation_mean(dim_zero_cat(self.errors), dim_zero_cat(self.simulations))
        return (1 - means[0] / means[1:].min()).float()
