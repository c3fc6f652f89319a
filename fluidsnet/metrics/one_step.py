"""Metrics of one step from a true state."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from fluidsnet.baselines import ballistic, constant_velocity
from fluidsnet.metrics.base import FrameMean, frame_means, simulation_mean
from fluidsnet.metrics.positions import distance_mm
from fluidsnet.particles import Particles


@final
class VelocityMSE(FrameMean):
    """Mean of (v̂ - v)² per component, m²/s²; in two dimensions there are two."""

    def update(
        self, predicted: Tensor, true: Tensor, particles: Particles, simulation: Tensor
    ) -> None:
        """Add a batch of predicted and true velocities, (N, 3) m/s; the rest as for `add`."""
        axes = particles.scene.dimension
        self.add(squared_error(predicted, true) * (3 / axes), particles, simulation)


@final
class PositionError(FrameMean):
    """Mean Euclidean distance ‖x̂ - x‖, mm."""

    def update(
        self, predicted: Tensor, true: Tensor, particles: Particles, simulation: Tensor
    ) -> None:
        """Add a batch of predicted and true positions, (N, 3) m; the rest as for `add`."""
        self.add(distance_mm(predicted, true, particles), particles, simulation)


@final
class TargetError(FrameMean):
    """Mean of (output - expected)² per component of the target, in the units of the loss."""

    def update(
        self, output: Tensor, expected: Tensor, particles: Particles, simulation: Tensor
    ) -> None:
        """Add a batch of outputs and their targets, (N, width); the rest as for `add`."""
        self.add(squared_error(output, expected), particles, simulation)


@final
class Skill(Metric):
    """Skill score of velocities: 1 - velocity_mse / the smaller one of the trivial predictors.

    1 is perfect, 0 is no better than the better trivial predictor; there is no lower bound.
    """

    full_state_update = False

    errors: list[Tensor]
    simulations: list[Tensor]

    def __init__(self) -> None:
        super().__init__()
        # (F, 3): of the prediction, constant velocity and ballistic.
        self.add_state("errors", [], dist_reduce_fx="cat")
        self.add_state("simulations", [], dist_reduce_fx="cat")

    def update(
        self, predicted: Tensor, true: Tensor, particles: Particles, simulation: Tensor
    ) -> None:
        """Add a batch.

        Args:
            predicted: (N, 3) velocities one step later, m/s.
            true: (N, 3) true velocities one step later, m/s.
            particles: True state that the prediction was made from.
            simulation: (F,) int64, number of the simulation of each frame.
        """
        velocities = (
            predicted,
            constant_velocity(particles).velocity,
            ballistic(particles).velocity,
        )
        errors = [frame_means(squared_error(velocity, true), particles) for velocity in velocities]
        self.errors.append(torch.stack(errors, dim=1))
        self.simulations.append(simulation)

    def compute(self) -> Tensor:
        """Return the skill over the frames added so far, ()."""
        means = simulation_mean(dim_zero_cat(self.errors), dim_zero_cat(self.simulations))
        return (1 - means[0] / means[1:].min()).float()


def squared_error(predicted: Tensor, true: Tensor) -> Tensor:
    """Return the mean of (predicted - true)² over the components, (N,), of (N, C) each."""
    return (predicted.double() - true.double()).square().mean(dim=1)
