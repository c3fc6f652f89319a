"""Normalization statistics of the training split."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
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
        least: (5,) least of `Scene.values` over the simulations; no limit where it is not known.
        greatest: (5,) greatest of them.
    """

    velocity_mean: Tensor
    velocity_deviation: Tensor
    change_mean: Tensor
    change_deviation: Tensor
    drift_deviation: Tensor
    least: Tensor = field(default_factory=lambda: torch.full((5,), -torch.inf))
    greatest: Tensor = field(default_factory=lambda: torch.full((5,), torch.inf))


@dataclass(frozen=True)
class Residuals:
    """What a prior leaves, over the fluid particles of frames of the training split.

    Attributes:
        change_deviation: () root mean square of v' - v̂, per component, m/s.
        drift_deviation: () root mean square of x' - x̂, per component, support radii.
        column_mean: (C,) mean of the prior's columns; empty without columns.
        column_deviation: (C,) deviation of each about its mean.
    """

    change_deviation: Tensor
    drift_deviation: Tensor
    column_mean: Tensor
    column_deviation: Tensor
