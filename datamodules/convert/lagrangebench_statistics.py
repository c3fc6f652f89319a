"""Normalization statistics of LagrangeBench: of displacements per frame, and of their changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from datamodules.convert.simulation import Array
from datamodules.schema import SceneAttributes

#: Deviations below this become 1, as LagrangeBench has it.
_LEAST_DEVIATION = 1e-7


@final
class TrajectoryStatistics:
    """Moments of one simulation's velocities and accelerations, added frame by frame.

    A velocity is xₜ - xₜ₋₁, along periodic axes to the nearest image, and an acceleration
    vₜ - vₜ₋₁; the time step counts as 1.

    Args:
        scene: Scene of the simulation.
    """

    def __init__(self, scene: SceneAttributes) -> None:
        self.scene = scene
        axes = slice(scene.dimension)
        widths = np.subtract(scene.domain_upper, scene.domain_lower)
        self._periods = np.where(scene.periodic, widths, np.inf)[axes]
        self._last: list[Array] = []
        # Sums of means and of mean squares of a frame, and their number; velocity, acceleration.
        self._sums = np.zeros((2, 2, scene.dimension))
        self._counts = np.zeros(2, int)

    def add(self, position: Array) -> None:
        """Add positions (N, dimension) of the fluid, m, of the next frame."""
        position = position.astype(np.float64)
        values = [position]
        if self._last:
            step = position - self._last[0]
            wraps = np.isfinite(self._periods)
            period = self._periods[wraps]
            step[:, wraps] -= period * np.round(step[:, wraps] / period)
            values.append(step)
        if len(self._last) > 1:
            values.append(step - self._last[1])
        for order, value in enumerate(values[1:]):
            self._sums[order] += value.mean(axis=0), np.square(value).mean(axis=0)
            self._counts[order] += 1
        self._last = values[:2]

    @staticmethod
    def normalization(trajectories: Sequence[TrajectoryStatistics]) -> dict[str, list[float]]:
        """Return mean and deviation of velocity and acceleration, each simulation with weight 1."""
        moments = np.mean(
            [it._sums / np.maximum(it._counts, 1)[:, None, None] for it in trajectories], axis=0
        )
        found = {}
        for name, (mean, square) in zip(("vel", "acc"), moments, strict=True):
            deviation = np.sqrt(np.maximum(square - mean**2, 0))
            found[f"{name}_mean"] = mean.tolist()
            found[f"{name}_std"] = np.where(deviation < _LEAST_DEVIATION, 1.0, deviation).tolist()
        return found
