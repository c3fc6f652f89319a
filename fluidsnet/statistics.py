"""Normalization statistics of the training split."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Statistics:
    """Means over the fluid particles of the training split, and one deviation for all axes.

    With Δt the time step and primes for the next state:

    Attributes:
        velocity_mean: (3,) of v, m/s.
        velocity_deviation: () of v about its mean, m/s.
        change_mean: (3,) of v' - v, m/s.
        change_deviation: () of v' - v about its mean, m/s.
        drift_deviation: () of x' - x - Δt·v about its mean, support radii.
    """

    velocity_mean: Tensor
    velocity_deviation: Tensor
    change_mean: Tensor
    change_deviation: Tensor
    drift_deviation: Tensor
