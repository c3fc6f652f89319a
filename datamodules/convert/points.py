"""Points of one file, and the fields that particles need."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from datamodules.convert.simulation import Array

#: Names of the velocity and of the number of a particle, in lower case, in order of preference.
_VELOCITY = ("velocity", "velocities", "vel", "v")
_NUMBER = ("id", "ids", "idp", "trackid", "particle_id", "particleid")


class Points(NamedTuple):
    """Points of a file.

    Attributes:
        position: (N, 3) m.
        fields: Values at the points by name, (N,) or (N, k).
    """

    position: Array
    fields: Mapping[str, Array]

    def velocity(self) -> Array | None:
        """Return the velocities (N, 3), m/s; None if there are none."""
        return self._first(_VELOCITY, (len(self.position), 3))

    def numbers(self) -> Array | None:
        """Return the number of each particle, (N,); None if there are none."""
        return self._first(_NUMBER, (len(self.position),))

    def sorted(self) -> Points:
        """Return the points in the order of their numbers, if they have any."""
        numbers = self.numbers()
        if numbers is None:
            return self
        order = np.argsort(numbers, kind="stable")
        fields = {name: values[order] for name, values in self.fields.items()}
        return Points(self.position[order], fields)

    def _first(self, names: tuple[str, ...], shape: tuple[int, ...]) -> Array | None:
        lower = {name.lower(): values for name, values in self.fields.items()}
        found = [lower[name] for name in names if name in lower]
        return next((values for values in found if values.shape == shape), None)
