"""Measurement of what a prior leaves in frames of the training split."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from fluidsnet.particles import Transitions
from fluidsnet.priors import Prior
from fluidsnet.statistics import Residuals


@torch.no_grad()
def measure_residuals(prior: Prior, samples: Iterable[Transitions]) -> Residuals:
    """Return the deviations of a prior's errors and columns over samples of one step."""
    changes: list[Tensor] = []
    drifts: list[Tensor] = []
    columns: list[Tensor] = []
    for sample in samples:
        state = sample.state
        guess = prior.guess(state, prior.describes)
        changes.append((sample.next_velocity[0] - guess.velocity).double())
        drift = sample.next_position[0] - guess.position
        drifts.append(drift.double() / state.scene.support_radius)
        if guess.columns is not None:
            columns.append(guess.columns.double())
    described = torch.cat(columns) if columns else torch.zeros(2, 0, dtype=torch.float64)
    return Residuals(
        change_deviation=torch.cat(changes).square().mean().sqrt().float(),
        drift_deviation=torch.cat(drifts).square().mean().sqrt().float(),
        column_mean=described.mean(dim=0).float(),
        column_deviation=described.std(dim=0).float(),
    )
