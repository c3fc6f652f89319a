"""The two predictors that know nothing of fluids, beside which every number stands."""

from __future__ import annotations

from fluidsnet.particles import Particles


def constant_velocity(particles: Particles, steps: int = 1) -> Particles:
    """Each particle flies on: v' = v, x' = x + t·v after t = `steps` time steps."""
    time = steps * particles.scene.time_step
    return particles.moved(particles.position + time * particles.velocity, particles.velocity)


def ballistic(particles: Particles, steps: int = 1) -> Particles:
    """Each particle falls freely: v' = v + t·g, x' = x + t·v + ½t²·g."""
    time, gravity = steps * particles.scene.time_step, particles.scene.gravity
    return particles.moved(
        particles.position + time * particles.velocity + time**2 / 2 * gravity,
        particles.velocity + time * gravity,
    )


#: By the names they have in logs and tables.
TRIVIAL = {"constant_velocity": constant_velocity, "ballistic": ballistic}
