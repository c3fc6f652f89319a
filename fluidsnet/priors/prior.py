"""Prior: the step that a network corrects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from torch import Tensor, nn

from fluidsnet.particles import Particles


@dataclass(frozen=True)
class Guess:
    """State one step later by a prior.

    Attributes:
        position: (N, 3) m.
        velocity: (N, 3) m/s.
    """

    position: Tensor
    velocity: Tensor


class Prior(nn.Module, ABC):
    """Step of the fluid particles that needs no training."""

    @abstractmethod
    def forward(self, particles: Particles) -> Guess:
        """Return the state one step later."""
