"""Motion of the solids of a drawn scene over the steps of a rollout."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datamodules.generate.bodies import Quaternion, turned
from datamodules.generate.moving_solids import MovingSolid

#: Distance from the surface of a solid up to which a particle belongs to it, m.
_ON_SURFACE = 1e-4


@final
class SolidCourse:
    """Places and velocities of solid particles, some of which belong to solids that move.

    Args:
        solids: Solids that move.
        start: (M, 3) of all solid particles at the start, m; those of `solids` come last.
        time_step: s.
    """

    def __init__(self, solids: Sequence[MovingSolid], start: Tensor, time_step: float) -> None:
        self.solids, self.time_step = solids, time_step
        self._start = start.double().numpy()
        self._rows = _rows(solids, self._start)

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        """Return position, m, and velocity, m/s, each (M, 3), after a step, counted from 0."""
        time = step * self.time_step
        position, velocity = self._start.copy(), np.zeros_like(self._start)
        for solid, rows in zip(self.solids, self._rows, strict=True):
            center, spin = np.array(solid.center), np.array(solid.spin)
            arm = turned(self._start[rows] - center, _rotation(spin * time))
            position[rows] = arm + center + solid.shift(time)
            velocity[rows] = np.array(solid.velocity(time)) + np.cross(spin, arm)
        return torch.from_numpy(position).float(), torch.from_numpy(velocity).float()


def _rotation(angles: NDArray[np.float64]) -> Quaternion:
    """Return the unit quaternion of a turn around an axis, given the angle along it, rad (3,)."""
    angle = float(np.linalg.norm(angles))
    x, y, z = (angles * (np.sin(angle / 2) / angle if angle else 0.0)).tolist()
    return float(np.cos(angle / 2)), x, y, z


def _rows(solids: Sequence[MovingSolid], points: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Return the rows of the particles of each solid."""
    apart = np.stack([solid.distance(points) for solid in solids])
    walls = np.flatnonzero(apart.min(axis=0) > _ON_SURFACE)
    # A wall may touch a solid; its particles come before.
    first = int(walls[-1]) + 1 if len(walls) else 0
    nearest = apart[:, first:].argmin(axis=0)
    return [first + np.flatnonzero(nearest == number) for number in range(len(solids))]
