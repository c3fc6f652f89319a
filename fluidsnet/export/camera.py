"""Perspective camera for pictures of particles: seen from slightly above, up against gravity.

A flat scene, such as one in two dimensions, is seen from the front.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_MIN_WIDTH = 400  # pixels, room for the title
_MARGIN = 1.1  # of a picture that the box fills
_FLAT = 0.03  # greatest depth of a flat box, in its longest edges


def up_axis(gravity: ArrayLike | None) -> Floats:
    """Return the axis of the box that points most against gravity, (3,); y without gravity.

    Args:
        gravity: (3,) m/s²; None for none.
    """
    pull = np.zeros(3) if gravity is None else np.asarray(gravity, float)
    axis = int(np.argmax(np.abs(pull))) if pull.any() else 1
    up = np.zeros(3)
    up[axis] = -1.0 if pull[axis] > 0 else 1.0
    return up


class Camera:
    """Camera that looks at the center of a box, which fills the picture.

    Attributes:
        width, height: Size of the picture, pixels.
        distance: Distance from the eye to the center of the box, m.
        eye: (3,), m.
        up: (3,) axis that is drawn upright.

    Args:
        lower: (3,) lower corner of the box, m.
        upper: (3,) upper corner of the box, m.
        max_size: Greatest width and height of the picture, pixels.
        gravity: (3,) m/s²; the axis of the box that it points along most is drawn upright. Without
            gravity y is up.
    """

    def __init__(
        self,
        lower: Floats,
        upper: Floats,
        max_size: tuple[int, int],
        gravity: ArrayLike | None = None,
    ) -> None:
        self.lower, self.upper, self.up = lower, upper, up_axis(gravity)
        edges = upper - lower
        # z comes towards the eye; where it is up, -y does, so that x goes right.
        toward = np.array([0.0, -1.0, 0.0] if self.up[2] else [0.0, 0.0, 1.0])
        flat = np.abs(toward) @ edges < _FLAT * edges.max()
        turn, rise = (0.0, 0.0) if flat else np.radians((28.0, 20.0))
        aside = np.cross(self.up, toward)
        level = np.sin(turn) * aside + np.cos(turn) * toward
        backward = np.cos(rise) * level + np.sin(rise) * self.up
        right = np.cross(self.up, backward)
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(backward, right), backward])
        self.distance = 2.6 * float(np.linalg.norm(upper - lower))
        self.eye = (lower + upper) / 2 + self.distance * backward
        self._pixels, self._origin = 1.0, np.zeros(2)
        corners = self.project(self.corners())[:, :2]
        first, last = corners.min(axis=0), corners.max(axis=0)
        margin = 0.02 * float((last - first).max())
        size = last - first + 2 * margin
        self._pixels = float(np.min(np.array(max_size) / size))
        self._origin = np.array([first[0] - margin, first[1] - margin]) * self._pixels
        self.width, self.height = (int(np.ceil(extent)) for extent in size * self._pixels)
        min_width = min(_MIN_WIDTH, max_size[0])
        if self.width < min_width:
            self._origin[0] -= (min_width - self.width) / 2
            self.width = min_width

    def corners(self) -> Floats:
        """Return the corners (8, 3) of the box, m; bit a of a row's index means upper on axis a."""
        upper = (np.arange(8)[:, None] >> np.arange(3)) & 1
        return np.where(upper, self.upper, self.lower)

    def view_angle(self, aspect: float) -> float:
        """Return the vertical angle, degrees, in which the box fills a picture.

        Args:
            aspect: Width of the picture over its height.
        """
        right, up, backward = self._axes @ (self.corners() - self.eye).T
        reach = max(np.abs(up / backward).max(), np.abs(right / backward).max() / aspect)
        return float(np.degrees(2 * np.arctan(_MARGIN * reach)))

    def floor(self) -> list[int]:
        """Return the indices of the four corners of the lowest side, in order around it."""
        axis = int(np.argmax(np.abs(self.up)))
        top = 0 if self.up[axis] > 0 else 1 << axis
        one, two = (1 << other for other in range(3) if other != axis)
        return [top, top | one, top | one | two, top | two]

    def project(self, points: Floats) -> Floats:
        """Project points (N, 3), m, to (N, 3): pixels right and down, and depth in m."""
        right, up, backward = (self._axes @ (points - self.eye).T).astype(np.float64)
        depth = -backward
        across = np.stack([right, -up]) / depth * self.distance * self._pixels
        return np.column_stack([across.T - self._origin, depth])

    def pixels_per_meter(self, depth: Floats) -> Floats:
        """Return the pixels per meter at a depth (N,), m."""
        return self.distance * self._pixels / depth
