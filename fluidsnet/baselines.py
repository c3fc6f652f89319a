"""Baselines: the trivial predictors, and the floor that an integrator sets."""

from __future__ import annotations

from typing import final

from fluidsnet.integrator import Integrator
from fluidsnet.particles import Particles
from fluidsnet.periodic import shortest
from fluidsnet.target import Motion


def constant_velocity(particles: Particles, steps: int = 1) -> Particles:
    """Predict v' = v and x' = x + t·v after t = `steps` time steps."""
    time = steps * particles.scene.time_step
    return particles.moved(particles.position + time * particles.velocity, particles.velocity)


def ballistic(particles: Particles, steps: int = 1) -> Particles:
    """Predict free fall: v' = v + t·g and x' = x + t·v + ½t²·g after t = `steps` time steps."""
    time = steps * particles.scene.time_step
    gravity = particles.per_particle(particles.scene.gravity)
    return particles.moved(
        particles.position + time * particles.velocity + time**2 / 2 * gravity,
        particles.velocity + time * gravity,
    )


#: The trivial predictors by the names they have in logs and tables.
TRIVIAL_PREDICTORS = {"constant_velocity": constant_velocity, "ballistic": ballistic}


@final
class Baselines:
    """States of the integrator floor and the trivial predictors along one rollout.

    The integrator floor is the position error that remains when the integrator is given the
    true velocity (and displacement) at every step.

    Args:
        start: True state that the rollout starts from.
        integrator: Integrator of the rollout.
    """

    #: Keys of the mapping that `after` returns, in order.
    names = ("integrator_floor", *TRIVIAL_PREDICTORS)

    def __init__(self, start: Particles, integrator: Integrator) -> None:
        self.start, self.integrator = start, integrator
        self._floor = self._true = start

    def after(self, step: int, true: Particles) -> dict[str, Particles]:
        """Return the baselines' states after a step; call it once for each step, in order.

        Args:
            step: Number of the step, counted from 1.
            true: True state after the step.
        """
        displacement = shortest(true.position - self._true.position, true)
        self._floor = self.integrator(self._floor, Motion(true.velocity, displacement))
        self._true = true
        trivial = (predict(self.start, step) for predict in TRIVIAL_PREDICTORS.values())
        states = (it.with_solids_of(true) for it in (self._floor, *trivial))
        return dict(zip(self.names, states, strict=True))
