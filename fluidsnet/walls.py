"""What happens to a particle that a step takes out of the domain."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import torch

from fluidsnet.particles import Particles


class Walls(ABC):
    """Corrects a state after its positions were integrated."""

    @abstractmethod
    def __call__(self, particles: Particles) -> Particles:
        """The state with no particle where the walls do not let it be."""


@final
class OpenWalls(Walls):
    """Nothing happens: walls are what the network has learned of solids (the paper's)."""

    def __call__(self, particles: Particles) -> Particles:
        return particles


@final
class StopAtWalls(Walls):
    """A particle stops at the wall it would cross: its velocity through the wall is lost.

    Args:
        clearance: least distance from the walls, in particle radii; in the solver's own
            small scenes no particle comes closer than 0.84.
    """

    def __init__(self, clearance: float = 0.8) -> None:
        self.clearance = clearance

    def __call__(self, particles: Particles) -> Particles:
        scene = particles.scene
        gap = self.clearance * scene.particle_radius
        inside = torch.clamp(particles.position, scene.domain_lower + gap, scene.domain_upper - gap)
        outward = torch.sign(particles.position - inside) * particles.velocity > 0
        return particles.moved(inside, particles.velocity.masked_fill(outward, 0.0))
