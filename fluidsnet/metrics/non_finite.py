"""`non_finite`: which rollouts blew up, and when."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class NonFinite(RolloutMetric):
    """Share of the rollouts in which a number was not finite within the first n steps.

    `compute` also gives `non_finite_step`, (R,): the step at which each rollout first had
    one, infinite where it never did.
    """

    names = ("non_finite",)

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        # Zero times what is not finite is not a number: one sum finds it.
        zero = (0 * predicted.position + 0 * predicted.velocity).sum()
        return zero.isnan()[None]

    def finish(self, values: Tensor) -> Tensor:
        return values.cummax(dim=1).values

    def compute(self) -> dict[str, Tensor]:
        broken = self.values[..., 0] > 0
        first = broken.int().argmax(dim=1) + 1.0
        return {**super().compute(), "non_finite_step": first.where(broken.any(dim=1), torch.inf)}
