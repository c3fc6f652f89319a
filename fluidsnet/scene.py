"""Scene: domain, gravity, fluid parameters, resolution and time step, per frame of a batch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import torch
from torch import Tensor

from fluidsnet.batch import ENTRIES, ROWS, SHARED, Batch
from fluidsnet.errors import UserError

Edges = tuple[float, float, float]

#: Values of a scene that may be an input of a network, and the number of columns of each.
VALUES = {"gravity": 3, "viscosity": 1, "surface_tension": 1}


@final
@dataclass(frozen=True)
class Scene(Batch):
    """Box of fluid and air of each of F frames, and the resolution and time step of all.

    Attributes:
        domain_lower: (F, 3) lower corner of the box, m.
        domain_upper: (F, 3) upper corner of the box, m.
        gravity: (F, 3) m/s².
        density0: (F,) rest density, kg/m³.
        viscosity: (F,) coefficient of the solver that made the data.
        surface_tension: (F,) coefficient of that solver.
        particle_radius: Half the spacing of particles at rest, m.
        support_radius: Neighbor cutoff, m.
        time_step: Time between two states, s: the frame interval times the stride.
        names: Name of each frame's simulation, for messages.
        edges: Edges of each frame's box, m, as numbers on the host, so that boxes are compared
            without a copy from the GPU.
        dimension: 3, or 2 where the third coordinate is constant and has no walls.
        periodic: Axes along which the box repeats; the sides across them have no walls.
        origins: Point that each frame's coordinates are relative to, m, on the host; none where
            they are as in the file.
    """

    domain_lower: Tensor = field(metadata=ROWS)
    domain_upper: Tensor = field(metadata=ROWS)
    gravity: Tensor = field(metadata=ROWS)
    density0: Tensor = field(metadata=ROWS)
    viscosity: Tensor = field(metadata=ROWS)
    surface_tension: Tensor = field(metadata=ROWS)
    particle_radius: float = field(metadata=SHARED)
    support_radius: float = field(metadata=SHARED)
    time_step: float = field(metadata=SHARED)
    names: tuple[str, ...] = field(metadata=ENTRIES)
    edges: tuple[Edges, ...] = field(metadata=ENTRIES)
    dimension: int = field(default=3, metadata=SHARED)
    origins: tuple[Edges, ...] = field(default=(), metadata=ENTRIES)
    periodic: tuple[bool, bool, bool] = field(default=(False, False, False), metadata=SHARED)

    @classmethod
    def single(
        cls,
        domain_lower: Sequence[float],
        domain_upper: Sequence[float],
        gravity: Sequence[float],
        particle_radius: float,
        support_radius: float,
        time_step: float,
        density0: float = 1000.0,
        viscosity: float = 0.0,
        surface_tension: float = 0.0,
        name: str = "scene",
        dimension: int = 3,
        origin: Edges = (0.0, 0.0, 0.0),
        periodic: tuple[bool, bool, bool] = (False, False, False),
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> Scene:
        """Return the scene of one frame from plain numbers; units as for the attributes."""

        def row(values: Sequence[float] | float) -> Tensor:
            return torch.tensor([values], device=device, dtype=dtype)

        x, y, z = (high - low for low, high in zip(domain_lower, domain_upper, strict=True))
        return cls(
            domain_lower=row(domain_lower),
            domain_upper=row(domain_upper),
            gravity=row(gravity),
            density0=row(density0),
            viscosity=row(viscosity),
            surface_tension=row(surface_tension),
            particle_radius=particle_radius,
            support_radius=support_radius,
            time_step=time_step,
            names=(name,),
            edges=((x, y, z),),
            dimension=dimension,
            origins=(origin,),
            periodic=periodic,
        )

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.edges)

    @property
    def extent(self) -> Tensor:
        """(F, 3) edges of the boxes, m."""
        return self.domain_upper - self.domain_lower

    @property
    def values(self) -> Tensor:
        """(F, 5) values of `VALUES`, in their order."""
        coefficients = torch.stack([self.viscosity, self.surface_tension], dim=1)
        return torch.cat([self.gravity, coefficients], dim=1)

    @property
    def particle_volume(self) -> float:
        """Volume of a fluid particle, the cube of the spacing, m³; in two dimensions its square."""
        return float((2 * self.particle_radius) ** self.dimension)

    def room(self, clearance: float) -> tuple[Tensor, Tensor]:
        """Return the corners (F, 3) of the boxes that centers of particles stay in, m.

        Args:
            clearance: Least distance from the walls, particle radii.
        """
        # In a box narrower than two clearances, particles stop in the middle.
        gap = (self.extent / 2).clamp_max(clearance * self.particle_radius)
        lower, upper = self.domain_lower + gap, self.domain_upper - gap
        for axis, repeats in enumerate(self.periodic):
            if repeats or axis >= self.dimension:
                lower[:, axis], upper[:, axis] = -torch.inf, torch.inf
        return lower, upper

    def joins(self, other: Scene) -> bool:
        """Return whether frames of both scenes can be one batch of any block."""
        shared = ("particle_radius", "support_radius", "time_step", "dimension", "periodic")
        return all(getattr(self, name) == getattr(other, name) for name in shared) and all(
            _same(self.edges[0], edges) for edges in (*self.edges, *other.edges)
        )

    def check_one_box(self, block: str) -> None:
        """Check that the boxes of all frames have the same edges.

        Args:
            block: Name of the block that needs it, for the message.

        Raises:
            UserError: two of them differ.
        """
        for name, edges in zip(self.names, self.edges, strict=True):
            if not _same(edges, self.edges[0]):
                raise UserError(
                    f"{block} has one grid over the domain and cannot mix the domains of "
                    f"{self.names[0]} ({_text(self.edges[0])} m) and {name} ({_text(edges)} m); "
                    "use a global feature without such a grid, such as VoxelField, or data of "
                    "one domain."
                )


def _same(one: Edges, two: Edges) -> bool:
    return all(math.isclose(a, b, rel_tol=1e-6) for a, b in zip(one, two, strict=True))


def _text(edges: Edges) -> str:
    return " x ".join(f"{edge:g}" for edge in edges)
