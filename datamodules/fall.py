"""Check of a simulation's gravity: kinetic energy comes from falling along it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Share of the gained kinetic energy that the work of gravity must explain.
_EXPLAINED = 0.5


@final
class Fall:
    """Kinetic energy that a fluid gains, beside the way that it falls.

    Between solids at rest, a fluid loses energy only. Where its kinetic energy grows without a
    fall along gravity, gravity or the axes are not those of the data.

    Args:
        gravity: m/s².
        particle_radius: m; gains of less than a fall by that much are not looked at.
    """

    def __init__(self, gravity: Sequence[float], particle_radius: float) -> None:
        self._gravity = np.array(gravity)
        self._strength = float(np.linalg.norm(gravity))
        self._least = self._strength * particle_radius
        self._start: tuple[Array, float] | None = None
        self._gained, self._moved = 0.0, np.zeros(3)

    def add(self, position: Array, velocity: Array) -> None:
        """Add a frame in order.

        Args:
            position: (N, 3) m.
            velocity: (N, 3) m/s.
        """
        center = position.mean(axis=0)
        energy = float(0.5 * np.square(velocity).sum(axis=1).mean())
        if self._start is None:
            self._start = center, energy
        gained = energy - self._start[1]
        if gained > self._gained:
            self._gained, self._moved = gained, center - self._start[0]

    def sentence(self) -> str | None:
        """Return what is suspicious, if anything is."""
        if self._strength == 0 or self._gained < self._least:
            return None
        if self._gravity @ self._moved > _EXPLAINED * self._gained:
            return None
        ways = [
            f"{'-' if moved < 0 else '+'}{axis}"
            for axis, moved in zip("xyz", self._moved, strict=True)
            if self._strength * abs(moved) > _EXPLAINED * self._gained
        ]
        gravity = ", ".join(f"{value:g}" for value in self._gravity)
        reason = (
            f"it would by a fall along {' or '.join(ways)}, so axes may be swapped"
            if ways
            else "gravity or units may be wrong"
        )
        return f"the fluid gets faster without falling along gravity, ({gravity}) m/s²: {reason}"
