"""From a motion to the next state: one step in time, Δt.

===================  =======================================  ==========================
integrator           next position x'                         needs
===================  =======================================  ==========================
`Euler`              x + Δt·v'  (paper, section 4.6)          the next velocity v'
`Trapezoid`          x + Δt·(v + v') / 2                      the next velocity v'
`Displacement`       x + d                                    a predicted displacement d
===================  =======================================  ==========================
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

from torch import Tensor

from fluidsnet.particles import Particles
from fluidsnet.target import Motion


class Integrator(ABC):
    """Moves the fluid particles; solids stay where they are.

    Attributes:
        needs_displacement: whether a motion must have one.
    """

    needs_displacement: bool = False

    def __call__(self, particles: Particles, motion: Motion) -> Particles:
        """The state one step later."""
        return particles.moved(
            particles.position + self.displacement(particles, motion), motion.velocity
        )

    @abstractmethod
    def displacement(self, particles: Particles, motion: Motion) -> Tensor:
        """How far each particle goes in the step, (N, 3) m."""


@final
class Euler(Integrator):
    """The paper's; at Δt = 20 ms it is off by millimeters even with the true velocity."""

    def displacement(self, particles: Particles, motion: Motion) -> Tensor:
        return particles.scene.time_step * motion.velocity


@final
class Trapezoid(Integrator):
    """Exact where the acceleration is constant over the step, as in free fall."""

    def displacement(self, particles: Particles, motion: Motion) -> Tensor:
        return particles.scene.time_step / 2 * (particles.velocity + motion.velocity)


@final
class Displacement(Integrator):
    """Goes where the network says, for a target that predicts the displacement."""

    needs_displacement = True

    def displacement(self, particles: Particles, motion: Motion) -> Tensor:
        if motion.displacement is None:
            raise ValueError("the motion has no displacement; use a target that predicts it")
        return motion.displacement
