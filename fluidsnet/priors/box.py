"""Boxes in which the prior keeps the particles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from torch import Tensor

from fluidsnet.particles import Particles


@final
@dataclass(frozen=True)
class Box:
    """Walls at which particles stop, a row for each particle or one for all, m."""

    lower: Tensor
    upper: Tensor

    @classmethod
    def of(cls, particles: Particles, clearance: float) -> Box:
        lower, upper = particles.scene.room(clearance)
        return cls(particles.per_particle(lower), particles.per_particle(upper))

    def inside(self, position: Tensor) -> Tensor:
        """Return positions (N, 3) moved into the box."""
        return position.clamp(self.lower, self.upper)

    def stop(self, position: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Return the state in which particles beyond a wall stop at it."""
        outward = ((position < self.lower) & (velocity < 0)) | (
            (position > self.upper) & (velocity > 0)
        )
        return position.clamp(self.lower, self.upper), velocity.masked_fill(outward, 0.0)
