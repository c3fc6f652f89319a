"""Damage and suspicious values of a simulation, found frame by frame."""

from __future__ import annotations

from typing import Any, final

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.damage import is_repeated, is_zero
from datamodules.fall import Fall
from datamodules.schema import GREATEST, Header, SceneAttributes
from datamodules.values import rounding

Array = NDArray[np.float64]


@final
class Suspicions:
    """Sentences on what looks wrong in a simulation.

    Args:
        scene: Scene of the simulation.
        header: Attributes of the file.
    """

    def __init__(self, scene: SceneAttributes, header: Header) -> None:
        self._scene, self._interval = scene, header.dt
        self._radius, self._support = header.particle_radius, header.support_radius
        self._lower = np.subtract(scene.domain_lower, header.particle_radius)
        self._upper = np.add(scene.domain_upper, header.particle_radius)
        self._fall = Fall(scene.gravity, header.particle_radius)
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
        if not all((np.abs(it) <= GREATEST).all() for it in (position, velocity)):
            self._bad.append(frame)
            self._before = None
            return False
        self.fastest = max(self.fastest, float(np.linalg.norm(velocity, axis=1).max()))
        if is_zero(position):
            self._zero.append(frame)
        self._fall.add(position, velocity)
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
        # Across periodic axes by the shortest way.
        periodic = np.array(self._scene.periodic)
        step -= np.where(periodic, np.round(step / self._width) * self._width, 0.0)
        path = self._interval * np.abs(velocity).max()
        if is_repeated(earlier, position, path, self._radius):
            self._twice.append(frame)
        if (np.abs(step) > 0.8 * self._width).any():
            self._wrapped.append(frame)
        # A row moves with its velocity, unless it changes to another particle. A particle that
        # hits a wall within the frame differs by a share of its path.
        moved = step - self._interval * (speed + velocity) / 2
        lengths = np.linalg.norm(speed, axis=1) + np.linalg.norm(velocity, axis=1)
        jump = np.linalg.norm(moved, axis=1) - self._interval * lengths / 8
        self._worst_jump = max(self._worst_jump, float(np.quantile(jump, 0.99)))

    def damage(self, group: h5py.Group) -> list[str]:
        """Return what no command takes from the file."""
        found = {f"not finite, or beyond {GREATEST:g}": self._bad, "all zero": self._zero}
        sentences = [
            f"{_frames(numbers)} {what}, the first is {numbers[0]}"
            for what, numbers in found.items()
            if numbers
        ]
        if not np.isfinite(_solids(group)).all():
            sentences.append("solids are not finite")
        return sentences

    def sentences(self, group: h5py.Group) -> list[str]:
        """Return what is suspicious in the frames and in the storage of the simulation."""
        far = float(np.abs([self._scene.domain_lower, self._scene.domain_upper]).max())
        stored = group["position"]
        times = np.diff(group["time"][()])
        found: dict[str, Any] = {
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
            **self._of_solids(_solids(group)),
        }
        swapped = self._fall.sentence() if group["solid_position"].ndim == 2 else None
        return [text for text, is_so in found.items() if is_so] + ([swapped] if swapped else [])

    def _of_solids(self, solids: Array) -> dict[str, bool]:
        if not len(solids) or not np.isfinite(solids).all():
            return {}
        beyond = np.maximum(self._lower - solids, solids - self._upper).max(axis=1)
        outside = int((beyond > self._support).sum())
        far = beyond.max() > np.max(self._width)
        same = len(solids) - len(np.unique(solids, axis=0))
        return {
            "solids are farther from the domain than it is wide: units may differ": far,
            f"{outside} of {len(solids)} solids are more than a support radius outside the "
            "domain": outside > 0 and not far,
            f"{same} solids are at the place of another": same > len(solids) / 100,
        }


def _solids(group: h5py.Group) -> Array:
    """Return the positions (M, 3) of the solids, m, those of the first frame where they move."""
    stored = group["solid_position"]
    return np.asarray(stored[0] if stored.ndim == 3 else stored[()], np.float64)


def _frames(numbers: list[int]) -> str:
    return f"{len(numbers)} frames are"


def _chunk(stored: h5py.Dataset) -> int:
    """Return the number of frames in a chunk; 1 where the data set has none."""
    return stored.chunks[0] if stored.chunks else 1
