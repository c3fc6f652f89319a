"""Detection of a fluid that has come to rest."""

from __future__ import annotations

import math
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from fluidsnet.particles import Particles

#: Speed below which a fluid is at rest, as a share of √(g·r) for a particle radius r. A pool of
#: `box_drops` keeps a share of 0.04, of `box_drops_80ms` 0.11.
SHARE = 0.15
#: Time that it must stay so slow, s.
DURATION = 0.5
#: Percentile of the speeds that must be below; single drops may still run down a wall.
PERCENTILE = 99.9


def rest_speed(start: Particles) -> float:
    """Return the default speed below which the fluid of a scene is at rest, m/s.

    Without gravity it is a radius a second.
    """
    scene = start.scene
    pull = float(scene.gravity[0].norm())
    return SHARE * math.sqrt(pull * scene.particle_radius) if pull else scene.particle_radius


@final
class RestWatch:
    """Watch for a fluid whose speeds stay below a bound.

    Args:
        bound: m/s.
    """

    def __init__(self, bound: float) -> None:
        self.bound = bound
        self._since = math.inf

    def at_rest(self, time: float, speed: NDArray[Any]) -> bool:
        """Return whether the fluid has been slow for `DURATION`, this state included.

        Args:
            time: s.
            speed: (N,) m/s.
        """
        if float(np.percentile(speed, PERCENTILE)) > self.bound:
            self._since = math.inf
        else:
            self._since = min(self._since, time)
        return time - self._since >= DURATION
