"""What every rollout is judged beside: its integrator's floor and the two trivial predictors."""

from __future__ import annotations

from typing import final

from torch import Tensor

from fluidsnet.integrator import Integrator
from fluidsnet.particles import Particles
from fluidsnet.target import Motion
from fluidsnet.trivial import ballistic, constant_velocity


@final
class Baselines:
    """Their states, step by step, from the start of a rollout.

    Args:
        start: the true state the rollout starts from.
        integrator: of the rollout; its floor is where it gets to, fed back over all steps,
            where each velocity (and displacement) it is given is the true one.
    """

    #: The keys of what `after` gives, in order.
    names = ("integrator_floor", "constant_velocity", "ballistic")

    def __init__(self, start: Particles, integrator: Integrator) -> None:
        self.start, self.integrator = start, integrator
        self._floor = self._true = start

    def after(self, step: int, true: Particles) -> dict[str, Particles]:
        """The states after a step; call it for each step, in order.

        Args:
            step: counted from 1.
            true: the true state then.
        """
        displacement: Tensor = true.position - self._true.position
        self._floor = self.integrator(self._floor, Motion(true.velocity, displacement))
        self._true = true
        states = (self._floor, constant_velocity(self.start, step), ballistic(self.start, step))
        return dict(zip(self.names, states, strict=True))
