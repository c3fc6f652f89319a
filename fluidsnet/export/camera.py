"""Perspective camera for pictures of particles: seen from slightly above, y up.

A flat scene, such as one in two dimensions, is seen from the front.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_MIN_WIDTH = 400  # pixels, room for the title
_FLAT = 0.03  # greatest depth of a flat box, in its longest edges


class Camera:
    """Camera that looks at the center of a box, which fills the picture.

    Attributes:
        width, height: Size of the picture, pixels.
        distance: Distance from the eye to the center of the box, m.
        eye: (3,), m.

    Args:
        lower: (3,) lower corner of the box, m.
        upper: (3,) upper corner of the box, m.
        max_size: Greatest width and height of the picture, pixels.
    """

    def __init__(self, lower: Floats, upper: Floats, max_size: tuple[int, int]) -> None:
        self.lower, self.upper = lower, upper
        edges = upper - lower
        turn, rise = (0.0, 0.0) if edges[2] < _FLAT * edges.max() else np.radians((28.0, 20.0))
        backward = np.array(
            [np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)]
        )
        right = np.cross([0.0, 1.0, 0.0], backward)
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

    def project(self, points: Floats) -> Floats:
        """Project points (N, 3), m, to (N, 3): pixels right and down, and depth in m."""
        right, up, backward = (self._axes @ (points - self.eye).T).astype(np.float64)
        depth = -backward
        across = np.stack([right, -up]) / depth * self.distance * self._pixels
        return np.column_stack([across.T - self._origin, depth])

    def pixels_per_meter(self, depth: Floats) -> Floats:
        """Return the pixels per meter at a depth (N,), m."""
        return self.distance * self._pixels / depth
