"""Free fall, the prior that knows gravity alone."""

from __future__ import annotations

from typing import final

from fluidsnet.particles import Particles
from fluidsnet.priors.prior import Guess, Prior


@final
class FreeFall(Prior):
    """Free fall over the step: x' = x + Δt·v + ½Δt²·g and v' = v + Δt·g."""

    knows_periodic = True
    knows = frozenset({"gravity"})

    def forward(self, particles: Particles, described: bool = False) -> Guess:
        step = particles.scene.time_step
        gravity = particles.per_particle(particles.scene.gravity)
        return Guess(
            particles.position + step * particles.velocity + step**2 / 2 * gravity,
            particles.velocity + step * gravity,
        )
