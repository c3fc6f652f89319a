"""Time integration of a motion over one step Δt.

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
    """Time integration of the fluid particles; solids do not move.

    Attributes:
        needs_displacement: The motion must have a displacement.
    """

    needs_displacement: bool = False

    def __call__(self, particles: Particles, motion: Motion) -> Particles:
        """Return the state one step later."""
        return particles.moved(
            particles.position + self.displacement(particles, motion), motion.velocity
        )

    @abstractmethod
    def displacement(self, particles: Particles, motion: Motion) -> Tensor:
        """Return the displacement of each particle over the step, (N, 3) m."""


@final
class Euler(Integrator):
    """The paper's semi-implicit Euler; at Δt = 20 ms its error is millimeters."""

    def displacement(self, particles: Particles, motion: Motion) -> Tensor:
        return particles.scene.time_step * motion.velocity


@final
class Trapezoid(Integrator):
    """Trapezoidal rule; exact for constant acceleration, as in free fall."""

    def displacement(self, particles: Particles, motion: Motion) -> Tensor:
        return particles.scene.time_step / 2 * (particles.velocity + motion.velocity)


@final
class Displacement(Integrator):
    """Predicted displacement, for a target that has one."""

    needs_displacement = True

    def displacement(self, particles: Particles, motion: Motion) -> Tensor:
        if motion.displacement is None:
            raise ValueError("the motion has no displacement; use DisplacementTarget")
        return motion.displacement
