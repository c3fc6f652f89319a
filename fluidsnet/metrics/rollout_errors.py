"""How far a rollout and the trivial predictors are from the truth, step by step."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.baselines import Baselines
from fluidsnet.integrator import Integrator
from fluidsnet.metrics.escaped import escaped
from fluidsnet.metrics.position_error import distance_mm
from fluidsnet.particles import Particles


@final
class RolloutErrors:
    """Compares states with the truth while a rollout runs.

    Args:
        start: the true state the rollout starts from.
        integrator: of the rollout; its floor is one of the `Baselines`.
    """

    #: What `update` gives, in order: mean distances in mm, and the share that escaped.
    names = (
        "position_error_mm",
        "integrator_floor_mm",
        "constant_velocity_mm",
        "ballistic_mm",
        "escaped",
    )

    def __init__(self, start: Particles, integrator: Integrator) -> None:
        self.start = start
        self._baselines = Baselines(start, integrator)

    def update(self, step: int, state: Particles, position: Tensor, velocity: Tensor) -> Tensor:
        """The errors after a step; call it for each step, in order.

        Args:
            step: counted from 1.
            state: predicted.
            position: (N, 3) true, m, on the state's device.
            velocity: (N, 3) true, m/s, on the state's device.

        Returns:
            (5,) float64 on the state's device, as `names` has them; infinite where not finite.
        """
        true = self.start.moved(position, velocity)
        guesses = (state, *self._baselines.after(step, true).values())
        errors = [distance_mm(guess.position, position).mean() for guess in guesses]
        errors.append(escaped(state))
        return torch.nan_to_num(torch.stack(errors), nan=torch.inf, posinf=torch.inf)
