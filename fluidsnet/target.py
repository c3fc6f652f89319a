"""Target: quantity that the head predicts, and its motion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.errors import UserError
from fluidsnet.particles import Particles
from fluidsnet.periodic import shortest
from fluidsnet.priors.prior import Guess
from fluidsnet.statistics import Residuals, Statistics


@dataclass(frozen=True)
class Motion:
    """Predicted motion over one step.

    Attributes:
        velocity: (N, 3) velocity of the next state, m/s.
        displacement: (N, 3) displacement over the step, m; None where it is not predicted.
    """

    velocity: Tensor
    displacement: Tensor | None = None


class Target(nn.Module, ABC):
    """Encode a motion as network output of order one, and decode it.

    Attributes:
        width: Number of columns of the output.
        gives_displacement: `decode` returns a displacement.
        reads_guess: `decode` and `encode` use the prior's guess.
        time_step: Time step that the model is for, s; 0 until training sets it, or for any.
    """

    width: int
    time_step: float = 0.0
    gives_displacement: bool = False
    reads_guess: bool = True

    @abstractmethod
    def set_statistics(self, statistics: Statistics) -> None:
        """Set the normalization from the training split."""

    def set_residuals(self, residuals: Residuals) -> None:
        """Set the normalization by what the prior leaves; by default there is none."""

    @abstractmethod
    def decode(self, output: Tensor, particles: Particles, guess: Guess) -> Motion:
        """Return the motion of a network output (N, width).

        Args:
            output: Output of the head.
            particles: State.
            guess: State one step later by the prior.
        """

    @abstractmethod
    def encode(
        self, particles: Particles, guess: Guess, position: Tensor, velocity: Tensor
    ) -> Tensor:
        """Return the network output (N, width) of a known next state.

        Args:
            particles: State.
            guess: State one step later by the prior.
            position: (N, 3) of the next state, m.
            velocity: (N, 3) of the next state, m/s.
        """


class _Standardized(Target):
    """Base of targets of three columns with a mean and one deviation, m/s."""

    width = 3
    reads_guess = False

    mean: Tensor
    deviation: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(3))
        self.register_buffer("deviation", torch.ones(()))


@final
class VelocityTarget(_Standardized):
    """The next velocity v' (the paper's, section 4.2)."""

    def set_statistics(self, statistics: Statistics) -> None:
        self.mean.copy_(statistics.velocity_mean)
        self.deviation.copy_(statistics.velocity_deviation)

    def decode(self, output: Tensor, particles: Particles, guess: Guess) -> Motion:
        return Motion(self.mean + self.deviation * output)

    def encode(
        self, particles: Particles, guess: Guess, position: Tensor, velocity: Tensor
    ) -> Tensor:
        return (velocity - self.mean) / self.deviation


@final
class AccelerationTarget(_Standardized):
    """The mean acceleration over the step times Δt, v' - v (the ablation of section 5.6)."""

    def set_statistics(self, statistics: Statistics) -> None:
        self.mean.copy_(statistics.change_mean)
        self.deviation.copy_(statistics.change_deviation)

    def decode(self, output: Tensor, particles: Particles, guess: Guess) -> Motion:
        return Motion(particles.velocity + self.mean + self.deviation * output)

    def encode(
        self, particles: Particles, guess: Guess, position: Tensor, velocity: Tensor
    ) -> Tensor:
        return (velocity - particles.velocity - self.mean) / self.deviation


@final
class DisplacementTarget(Target):
    """Deviation of displacement and velocity from the prior's step.

    x' = x̂ + d and v' = v̂ + c with x̂ and v̂ of the prior, by default free fall; c and d are
    predicted in units of what the prior leaves in the training split.
    """

    width = 6
    gives_displacement = True

    change_deviation: Tensor
    drift_radii: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("change_deviation", torch.ones(()))
        self.register_buffer("drift_radii", torch.ones(()))

    def set_statistics(self, statistics: Statistics) -> None:
        self.change_deviation.copy_(statistics.change_deviation)
        self.drift_radii.copy_(statistics.drift_deviation)

    def set_residuals(self, residuals: Residuals) -> None:
        self.change_deviation.copy_(residuals.change_deviation)
        self.drift_radii.copy_(residuals.drift_deviation)

    def decode(self, output: Tensor, particles: Particles, guess: Guess) -> Motion:
        drift = self._drift(particles) * output[:, 3:]
        return Motion(
            guess.velocity + self.change_deviation * output[:, :3],
            guess.position - particles.position + drift,
        )

    def encode(
        self, particles: Particles, guess: Guess, position: Tensor, velocity: Tensor
    ) -> Tensor:
        change = (velocity - guess.velocity) / self.change_deviation
        drift = shortest(position - guess.position, particles)
        return torch.cat([change, drift / self._drift(particles)], dim=1)

    def _drift(self, particles: Particles) -> Tensor:
        """Return the deviation of d in m, ()."""
        return self.drift_radii * particles.scene.support_radius


@final
class PriorAlone(Target):
    """No correction: the prior's step is the model's, which has no weights.

    Args:
        time_step: Time step that the prior's numbers are for, s; None for any.

    Raises:
        UserError: The time step is not above zero.
    """

    width = 0
    gives_displacement = True

    def __init__(self, time_step: float | None = None) -> None:
        super().__init__()
        if time_step is not None and not time_step > 0:
            raise UserError(f"PriorAlone: time_step is {time_step}; set seconds, or null for any.")
        self.time_step = time_step or 0.0

    def set_statistics(self, statistics: Statistics) -> None:
        pass

    def decode(self, output: Tensor, particles: Particles, guess: Guess) -> Motion:
        return Motion(guess.velocity, guess.position - particles.position)

    def encode(
        self, particles: Particles, guess: Guess, position: Tensor, velocity: Tensor
    ) -> Tensor:
        return position.new_empty(len(position), 0)
