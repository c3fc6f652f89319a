"""Suspicious values of a simulation, found frame by frame."""

from __future__ import annotations

from typing import Any, final

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.schema import SceneAttributes
from datamodules.values import rounding

Array = NDArray[np.float64]


@final
class Suspicions:
    """Sentences on what looks wrong in a simulation.

    Args:
        scene: Scene of the simulation.
        particle_radius: m.
        interval: Time between two frames, s.
    """

    def __init__(self, scene: SceneAttributes, particle_radius: float, interval: float) -> None:
        self._scene, self._radius, self._interval = scene, particle_radius, interval
        self._lower = np.subtract(scene.domain_lower, particle_radius)
        self._upper = np.add(scene.domain_upper, particle_radius)
        self._width = np.subtract(scene.domain_upper, scene.domain_lower)
        self._before: tuple[Array, Array] | None = None
        self._bad: list[int] = []
        self._zero: list[int] = []
        self._twice: list[int] = []
        self._wrapped: list[int] = []
        self._escaped, self._worst_jump, self.fastest = 0, 0.0, 0.0

    def add(self, frame: int, position: Array, velocity: Array) -> bool:
        """Add a frame in order; return whether its values are finite.

        Args:
            frame: Number of the frame.
            position: (N, 3) m.
            velocity: (N, 3) m/s.
        """
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            self._bad.append(frame)
            self._before = None
            return False
        self.fastest = max(self.fastest, float(np.linalg.norm(velocity, axis=1).max()))
        if len(position) > 1 and not position.any():
            self._zero.append(frame)
        outside = np.any((position < self._lower) | (position > self._upper), axis=1)
        self._escaped = max(self._escaped, int(outside.sum()))
        if self._before is not None:
            self._compare(frame, position, velocity, *self._before)
        self._before = position, velocity
        return True

    def _compare(
        self, frame: int, position: Array, velocity: Array, earlier: Array, speed: Array
    ) -> None:
        step = position - earlier
        if speed.any() and not step.any():
            self._twice.append(frame)
        if (np.abs(step) > 0.8 * self._width).any():
            self._wrapped.append(frame)
        # A row moves with its velocity, unless it changes to another particle. A particle that
        # hits a wall within the frame differs by a share of its path.
        moved = step - self._interval * (speed + velocity) / 2
        lengths = np.linalg.norm(speed, axis=1) + np.linalg.norm(velocity, axis=1)
        jump = np.linalg.norm(moved, axis=1) - self._interval * lengths / 8
        self._worst_jump = max(self._worst_jump, float(np.quantile(jump, 0.99)))

    def sentences(self, group: h5py.Group) -> list[str]:
        """Return what was found, and what the data sets of the simulation show by themselves."""
        far = float(np.abs([self._scene.domain_lower, self._scene.domain_upper]).max())
        stored = group["position"]
        times = np.diff(group["time"][()])
        found: dict[str, Any] = {
            f"{_frames(self._bad)} not finite, the first is {min(self._bad, default=0)}": self._bad,
            f"{_frames(self._zero)} all zero, the first is {min(self._zero, default=0)}": (
                self._zero
            ),
            f"{_frames(self._twice)} the same as the one before though the fluid moves, the first "
            f"is {min(self._twice, default=0)}": self._twice,
            "particles cross the whole box within a frame, first in "
            f"{min(self._wrapped, default=0)}: positions may be those of a periodic box, wrapped": (
                self._wrapped
            ),
            f"up to {self._escaped} particles are outside the domain at once": self._escaped,
            f"positions and velocities disagree by {self._worst_jump:.3g} m per frame for 1 % of "
            "the particles: rows may not keep their particle, or dt may be wrong": (
                self._worst_jump > 2 * self._radius
            ),
            "the frames are not dt apart": not np.allclose(
                times, self._interval, rtol=1e-3, atol=0
            ),
            "nothing moves": self.fastest == 0,
            f"float32 tells places {rounding(far):.2g} m apart so far from zero; store positions "
            "as float64": stored.dtype.itemsize < 8 and rounding(far) > self._radius / 100,
            f"a chunk of positions holds {_chunk(stored)} frames, all of which are read for one; "
            "store one frame a chunk": _chunk(stored) > 1,
            **self._of_solids(group["solid_position"]),
        }
        return [text for text, is_so in found.items() if is_so]

    def _of_solids(self, stored: h5py.Dataset) -> dict[str, bool]:
        solids = np.asarray(stored[0] if stored.ndim == 3 else stored[()], np.float64)
        if not len(solids):
            return {}
        finite = bool(np.isfinite(solids).all())
        reach = np.max(self._width)
        far = finite and bool(
            ((solids < self._lower - reach) | (solids > self._upper + reach)).any()
        )
        same = len(solids) - len(np.unique(solids, axis=0))
        return {
            "solids are not finite": not finite,
            "solids are farther from the domain than it is wide: units may differ": far,
            f"{same} solids are at the place of another": same > len(solids) / 100,
        }


def _frames(numbers: list[int]) -> str:
    return f"{len(numbers)} frames are"


def _chunk(stored: h5py.Dataset) -> int:
    """Return the number of frames in a chunk; 1 where the data set has none."""
    return stored.chunks[0] if stored.chunks else 1
