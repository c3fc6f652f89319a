"""Scene: domain, gravity, resolution and time step of one simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Scene:
    """Box of fluid and air, and the time step that is learned.

    Attributes:
        domain_lower: (3,) lower corner of the box, m.
        domain_upper: (3,) upper corner of the box, m.
        gravity: (3,) m/s².
        particle_radius: Half the spacing of particles at rest, m.
        support_radius: Neighbor cutoff, m.
        time_step: Time between two states, s: the frame interval times the stride.
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

    def difference(self, other: Scene) -> str | None:
        """Return the first field that differs and both values as text; None if all are equal."""
        for field in fields(self):
            one, two = getattr(self, field.name), getattr(other, field.name)
            if isinstance(one, Tensor):
                if (one.dtype, one.device) != (two.dtype, two.device):
                    one, two = (one.dtype, str(one.device)), (two.dtype, str(two.device))
                else:
                    one, two = one.tolist(), two.tolist()
            if one != two:
                return f"{field.name} is {one} and {two}"
        return None

    def to(self, device: torch.device | str, non_blocking: bool = False) -> Scene:
        """Return the scene with its tensors on a device."""
        return self._each(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> Scene:
        """Return the scene with its tensors in page-locked memory."""
        return self._each(Tensor.pin_memory)

    def _each(self, change: Callable[[Tensor], Tensor]) -> Scene:
        return replace(
            self,
            domain_lower=change(self.domain_lower),
            domain_upper=change(self.domain_upper),
            gravity=change(self.gravity),
        )
