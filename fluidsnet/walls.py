"""Wall condition: correction of particles that a step moves out of the domain."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import torch

from fluidsnet.particles import Particles


class Walls(ABC):
    """Wall condition at the border of the domain, applied after time integration."""

    @abstractmethod
    def __call__(self, particles: Particles) -> Particles:
        """Return the state with the wall condition applied."""


@final
class OpenWalls(Walls):
    """No condition: the network learns walls from solid particles (the paper's)."""

    def __call__(self, particles: Particles) -> Particles:
        return particles


@final
class StopAtWalls(Walls):
    """Inelastic walls: a particle that crosses one stops at it and loses its normal velocity.

    Args:
        clearance: Minimum distance from the walls, particle radii; in small scenes of the
            solver no particle was closer than 0.84.
    """

    def __init__(self, clearance: float = 0.8) -> None:
        self.clearance = clearance

    def __call__(self, particles: Particles) -> Particles:
        lower, upper = map(particles.per_particle, particles.scene.room(self.clearance))
        inside = torch.clamp(particles.position, lower, upper)
        outward = torch.sign(particles.position - inside) * particles.velocity > 0
        return particles.moved(inside, particles.velocity.masked_fill(outward, 0.0))
