"""A rollout: a prediction fed back, one step after another."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from fluidsnet.integrator import Integrator
from fluidsnet.network import Network
from fluidsnet.particles import Particles, RolloutStart
from fluidsnet.walls import Walls


@torch.no_grad()
def rollout(
    network: Network, integrator: Integrator, walls: Walls, start: Particles, steps: int
) -> Iterator[Particles]:
    """Yields the states after 1, 2, … steps; only the last is kept in memory.

    Args:
        network: in evaluation mode.
        integrator: from velocity to position.
        walls: what happens at the domain's border.
        start: the first state, which is not yielded.
        steps: how many to go.
    """
    state = start
    for _ in range(steps):
        state = walls(integrator(state, network.motion(state)))
        yield state


class RolloutObserver:
    """A callback that sees each state of a rollout as it comes; override what is of use."""

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Before the first step."""

    def on_rollout_step(self, start: RolloutStart, step: int, state: Particles) -> None:
        """After step number `step`, counted from 1."""

    def on_rollout_end(self, start: RolloutStart) -> None:
        """After the last step, or after an error ended the rollout."""
