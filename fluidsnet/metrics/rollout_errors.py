"""How far a rollout and the trivial predictors are from the truth, step by step."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.integrator import Integrator
from fluidsnet.metrics.position_error import distance_mm
from fluidsnet.particles import Particles
from fluidsnet.target import Motion
from fluidsnet.trivial import ballistic, constant_velocity


@final
class RolloutErrors:
    """Compares states with the truth while a rollout runs.

    Args:
        start: the true state the rollout starts from.
        integrator: of the rollout; its floor is what it misses by, fed back over all
            steps, where each velocity (and displacement) it gets is the true one.
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
        self.start, self.integrator = start, integrator
        self._floor = self._true = start

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
        motion = Motion(velocity, position - self._true.position)
        self._floor = self.integrator(self._floor, motion)
        self._true = self._true.moved(position, velocity)
        guesses = (
            state,
            self._floor,
            constant_velocity(self.start, step),
            ballistic(self.start, step),
        )
        errors = [distance_mm(guess.position, position).mean() for guess in guesses]
        errors.append(escaped(state))
        return torch.nan_to_num(torch.stack(errors), nan=torch.inf, posinf=torch.inf)


def escaped(particles: Particles) -> Tensor:
    """`escaped`: the share of fluid particles more than a radius outside the domain, (), float64.

    A particle that is nowhere (not finite) has escaped.
    """
    scene = particles.scene
    reach = scene.extent / 2 + scene.particle_radius
    center = (scene.domain_lower + scene.domain_upper) / 2
    inside = ((particles.position - center).abs() <= reach).all(dim=1)
    return 1 - inside.double().mean()
