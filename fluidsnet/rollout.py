"""Rollout: feed each prediction back as the next input."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import torch

from fluidsnet.baselines import Baselines
from fluidsnet.errors import UserError
from fluidsnet.integrator import Integrator
from fluidsnet.model import Model
from fluidsnet.particles import Particles, RolloutStart, SolidMotion


@torch.no_grad()
def rollout(
    model: Model, start: Particles, steps: int, solids: SolidMotion | None = None
) -> Iterator[Particles]:
    """Yield the states after 1, 2, … steps; only the last one is kept in memory.

    Args:
        model: Model in evaluation mode.
        start: First state, which is not yielded.
        steps: Number of steps.
        solids: Motion of the solids; None where they rest.

    Raises:
        UserError: The model was trained at another time step than the state's or on other scenes,
            or the solids move and their motion is not given.
    """
    model.check_time_step(start.scene.time_step)
    model.check_scenes(start.scene)
    if start.solids_move and solids is None:
        raise UserError(
            "The solids of this scene move: give their motion, such as that of "
            "datamodules.read_motion, as `solids`."
        )
    state = start
    for step in range(1, steps + 1):
        state = with_solids(model.step(state), solids, step)
        yield state


def with_solids(state: Particles, solids: SolidMotion | None, step: int) -> Particles:
    """Return a state with the solids as they are after a step, on its device.

    Args:
        state: State.
        solids: Motion of the solids; None where they rest.
        step: Number of the step, counted from 1.
    """
    if solids is None:
        return state
    device = state.position.device
    return state.with_solids(*(values.to(device, non_blocking=True) for values in solids[step]))


def reference_rollout(
    start: RolloutStart, integrator: Integrator
) -> Iterator[dict[str, Particles]]:
    """Yield "truth" and the baselines by name after 1, 2, … steps; nothing past the truth's end.

    Args:
        start: Start of the rollout; its device is the one of the states.
        integrator: Integrator of the model that is compared with them.
    """
    baselines = Baselines(start.state, integrator)
    for step in range(1, start.steps + 1):
        states: dict[str, Particles] = {}
        if step <= start.known_steps:
            device = start.state.position.device
            true = start.state.moved(*(value.to(device) for value in start.truth[step]))
            true = with_solids(true, start.solids, step)
            states = {**baselines.after(step, true), "truth": true}
        yield states


class RolloutObserver:
    """Interface of a callback that receives each state of the rollouts of `predict`."""

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Do nothing; called before the first step of each rollout."""

    def on_rollout_step(
        self, start: RolloutStart, step: int, states: Mapping[str, Particles]
    ) -> None:
        """Run after a step.

        Args:
            start: Start of the rollout.
            step: Number of the step, counted from 1.
            states: State of "model"; up to the truth's end also of "truth" and the baselines.
        """

    def on_rollout_end(self, start: RolloutStart) -> None:
        """Do nothing; called after the last step, or after an error ended the rollout."""
