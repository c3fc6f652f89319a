"""Scene: what of the world around the particles is modeled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Scene:
    """A box of fluid and air, and the step in time that is learned.

    Attributes:
        domain_lower: (3,) lower corner of the box, m.
        domain_upper: (3,) upper corner of the box, m.
        gravity: (3,) m/s².
        particle_radius: m; particles at rest lie two radii apart.
        support_radius: m; who is further away is no neighbor.
        time_step: s from a state to the next: the frame interval times the stride.
    """

    domain_lower: Tensor
    domain_upper: Tensor
    gravity: Tensor
    particle_radius: float
    support_radius: float
    time_step: float

    @property
    def extent(self) -> Tensor:
        """(3,) edges of the box, m."""
        return self.domain_upper - self.domain_lower

    def to(self, device: torch.device | str, non_blocking: bool = False) -> Scene:
        """The scene with its tensors on a device."""
        return replace(
            self,
            domain_lower=self.domain_lower.to(device, non_blocking=non_blocking),
            domain_upper=self.domain_upper.to(device, non_blocking=non_blocking),
            gravity=self.gravity.to(device, non_blocking=non_blocking),
        )

    def pin_memory(self) -> Scene:
        """The scene with its tensors in page-locked memory."""
        return replace(
            self,
            domain_lower=self.domain_lower.pin_memory(),
            domain_upper=self.domain_upper.pin_memory(),
            gravity=self.gravity.pin_memory(),
        )
