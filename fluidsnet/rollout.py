"""Rollout: a prediction fed back, one step after another."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from fluidsnet.model import Model
from fluidsnet.particles import Particles, RolloutStart


@torch.no_grad()
def rollout(model: Model, start: Particles, steps: int) -> Iterator[Particles]:
    """Yield the states after 1, 2, … steps; only the last one is kept in memory.

    Args:
        model: Model in evaluation mode.
        start: First state, which is not yielded.
        steps: Number of steps.
    """
    state = start
    for _ in range(steps):
        state = model.step(state)
        yield state


class RolloutObserver:
    """Interface of a callback that receives each state of a rollout."""

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Run before the first step."""

    def on_rollout_step(self, start: RolloutStart, step: int, state: Particles) -> None:
        """Run after a step, counted from 1."""

    def on_rollout_end(self, start: RolloutStart) -> None:
        """Run after the last step, or after an error ended the rollout."""
