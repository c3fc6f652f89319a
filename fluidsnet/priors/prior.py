"""Prior: the step that a network corrects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from fluidsnet.neighbors.search import Neighbors
from fluidsnet.particles import Particles
from fluidsnet.scene import Scene


@dataclass(frozen=True)
class Guess:
    """State one step later by a prior, and what a network may use of it.

    Attributes:
        position: (N, 3) m.
        velocity: (N, 3) m/s.
        neighbors: Fluid neighbors of the fluid particles in the last search of the step, all
            within the support radius then: if j is one of i, i is one of j. None without one.
        columns: (N, C) description of the state without units; None of a prior without one.
    """

    position: Tensor
    velocity: Tensor
    neighbors: Neighbors | None = None
    columns: Tensor | None = None


class Prior(nn.Module, ABC):
    """Step of the fluid particles that needs no training.

    Attributes:
        describes: Its guess has neighbors and columns.
        knows_periodic: It steps scenes with periodic axes.
        knows: Values of the scene that its step depends on, of `fluidsnet.scene.VALUES`.
    """

    describes: bool = False
    knows_periodic: bool = False
    knows: frozenset[str] = frozenset()

    @abstractmethod
    def forward(self, particles: Particles, described: bool) -> Guess:
        """Return the state one step later.

        Args:
            particles: N fluid particles and the solid ones.
            described: Whether neighbors and columns are needed.
        """

    def doubts(self, scenes: Scene) -> list[str]:
        """Return sentences on scenes for which the step is not made; none by default.

        Args:
            scenes: Scenes to step.
        """
        return []

    def guess(self, particles: Particles, described: bool = False) -> Guess:
        """Return `forward` of the particles, whose gradient is that of free fall.

        Gradients through the pressures would take the memory of every sweep.
        """
        position, velocity = particles.position, particles.velocity
        if not (position.requires_grad or velocity.requires_grad):
            return self.forward(particles, described)
        with torch.no_grad():
            guess = self.forward(particles.moved(position.detach(), velocity.detach()), described)
        # Zeros that carry the gradient.
        shift, turn = position - position.detach(), velocity - velocity.detach()
        return replace(
            guess,
            position=guess.position + shift + particles.scene.time_step * turn,
            velocity=guess.velocity + turn,
        )
