"""Options of a conversion: what the data does not say."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from datamodules.convert.simulation import Array
from fluidsnet.errors import UserError


@dataclass(frozen=True)
class Options:
    """Values given on the command line; None where an option is absent.

    Attributes:
        dt: Time between two frames, s.
        particle_radius: m.
        gravity: (3,) m/s².
        domain: Lower and upper corner of the box, (6,) m.
        viscosity: Coefficient of the solver.
        density0: Rest density, kg/m³.
        walls: File with the particles of the walls.
        frames: Patterns of the names of the files of frames.
        split: Splits, as for `datamodules.convert.splits.assign`.
    """

    dt: float | None = None
    particle_radius: float | None = None
    gravity: list[float] | None = None
    domain: list[float] | None = None
    viscosity: float | None = None
    density0: float | None = None
    walls: str | None = None
    frames: list[str] | None = None
    split: list[str] | None = None

    def __post_init__(self) -> None:
        for name, least in (("dt", 0.0), ("particle_radius", 0.0), ("density0", 0.0)):
            value = getattr(self, name)
            if value is not None and not least < value < math.inf:
                raise UserError(f"{flag(name)} is {value:g}; it must be finite and above zero.")
        if self.viscosity is not None and not 0 <= self.viscosity < math.inf:
            raise UserError(f"--viscosity is {self.viscosity:g}; it must be at least zero.")
        for name in ("gravity", "domain"):
            if not np.isfinite(getattr(self, name) or 0).all():
                raise UserError(f"{flag(name)} is {getattr(self, name)}; it must be finite.")
        if self.domain is not None and not np.less(self.domain[:3], self.domain[3:]).all():
            raise UserError(
                f"--domain is {self.domain}; give the lower corner, then the upper, which must be "
                "above it on every axis."
            )

    def refuse_others(self, taken: frozenset[str], what: str) -> None:
        """Raise a `UserError` if an option is set that a format does not take.

        Args:
            taken: Names of the options that it takes.
            what: Data or output of the format, for the message.
        """
        for field in fields(self):
            if field.name not in taken and getattr(self, field.name) is not None:
                raise UserError(f"{flag(field.name)} has no effect on {what}; leave it out.")

    def box(self, walls: Array) -> dict[str, Any]:
        """Return `domain_lower` and `domain_upper`: as given, else what bounds the walls.

        Args:
            walls: (M, 3) positions of their particles, m.

        Raises:
            UserError: It is not given, and the walls bound no volume.
        """
        corners = self.domain
        if corners is None:
            if not len(walls) or not (np.ptp(walls, axis=0) > 0).all():
                raise UserError(
                    "the data does not say how large the box is; give --domain X0 Y0 Z0 X1 Y1 Z1, "
                    "its lower and upper corner."
                )
            corners = [*walls.min(axis=0).tolist(), *walls.max(axis=0).tolist()]
        x0, y0, z0, x1, y1, z1 = corners
        return {"domain_lower": (x0, y0, z0), "domain_upper": (x1, y1, z1)}

    def given(self, names: tuple[str, ...], **known: Any) -> dict[str, Any]:
        """Return the values of options: as given, else as known from the data.

        Args:
            names: Names of the options.
            **known: Values from the data; None where it has none.

        Raises:
            UserError: Some are neither given nor known.
        """
        values = {
            name: known.get(name) if getattr(self, name) is None else getattr(self, name)
            for name in names
        }
        if missing := [flag(name) for name, value in values.items() if value is None]:
            raise UserError(f"the data does not say all that is needed; give {', '.join(missing)}.")
        return values


def flag(name: str) -> str:
    """Return the option of the command line for a name."""
    return f"--{name.replace('_', '-')}"
