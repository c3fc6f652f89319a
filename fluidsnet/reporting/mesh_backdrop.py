"""Domain backdrop for TensorBoard's mesh view."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from fluidsnet.scene import Scene

# Dark, since the page and the fastest particles are white.
_SHEET, _EDGE = (34, 42, 54), (109, 122, 140)  # red, green, blue
_VIEW = 40  # vertical field of view, degrees
_MAX_POINTS = 48  # along an edge

Floats = NDArray[np.float32]


@final
class MeshBackdrop:
    """Two copies of the domain side by side: floor, back wall and edges, as points.

    Args:
        scene: Scene of one frame, with the domain.

    Attributes:
        points: (E, 3) m.
        colors: (E, 3) uint8, red, green, blue.
        shifts: Offset of the left and of the right copy from the domain, (3,) m each.
        config: Settings of camera and points for `SummaryWriter.add_mesh`.
    """

    def __init__(self, scene: Scene) -> None:
        self._lower: Floats = scene.domain_lower[0].cpu().numpy().astype(np.float32)
        self._width: Floats = scene.domain_upper[0].cpu().numpy().astype(np.float32) - self._lower
        apart: Floats = np.array([0.55 * self._width[0], 0, 0], np.float32)
        middle: Floats = self._lower + self._width / np.float32(2)
        self.shifts: tuple[Floats, Floats] = (-middle - apart, -middle + apart)
        # Smaller than the particles: points without shading would merge.
        size = 1.7 * scene.particle_radius
        sheets, edges = self._sheets(size), self._edges()
        domain = self._lower + np.concatenate([sheets, edges]) * self._width
        self.points: Floats = np.concatenate([domain + shift for shift in self.shifts])
        colors = np.array([_SHEET] * len(sheets) + [_EDGE] * len(edges), np.uint8)
        self.colors: NDArray[np.uint8] = np.tile(colors, (2, 1))
        self.config = self._camera(size)

    def near(self, position: Floats) -> NDArray[np.bool_]:
        """Return a mask (N,) of particles at most a quarter of the domain's width outside it.

        Args:
            position: (N, 3) m; particles that are not finite are False.
        """
        with np.errstate(invalid="ignore"):
            offset: Floats = np.abs((position - self._lower) / self._width - 0.5)
            return np.asarray((offset <= 0.75).all(axis=1))

    def _sheets(self, size: float) -> Floats:
        """Return points of floor and back wall, as shares of the domain, (P, 3)."""
        x, y, z = (
            np.linspace(0, 1, int(np.clip(width / size, 2, _MAX_POINTS)), dtype=np.float32)
            for width in self._width
        )
        floor = np.stack(np.meshgrid(x, [np.float32(0)], z), axis=-1).reshape(-1, 3)
        wall = np.stack(np.meshgrid(x, y, [np.float32(0)]), axis=-1).reshape(-1, 3)
        # Slightly outside, so that no particle intersects them.
        gap = size / self._width
        floor[:, 1] -= gap[1]
        wall[:, 2] -= gap[2]
        return np.concatenate([floor, wall])

    def _edges(self) -> Floats:
        """Return points of the twelve edges, as shares of the domain, (P, 3)."""
        along = np.linspace(0, 1, _MAX_POINTS)
        points = np.empty((3, 4, _MAX_POINTS, 3), np.float32)
        for axis in range(3):
            for corner in range(4):
                points[axis, corner, :, axis] = along
                points[axis, corner, :, (axis + 1) % 3] = corner & 1
                points[axis, corner, :, (axis + 2) % 3] = corner >> 1
        return points.reshape(-1, 3)

    def _camera(self, size: float) -> dict[str, Any]:
        """Return a camera in front and above that shows both copies."""
        width, _, depth = (float(extent) for extent in self._width)
        away = 2.6 * width + depth / 2
        rise = np.radians(18.0)
        return {
            "camera": {
                "cls": "PerspectiveCamera",
                "fov": _VIEW,
                "near": 0.01 * away,
                "far": 100 * away,
                "position": [0.0, float(away * np.sin(rise)), float(away * np.cos(rise))],
                "lookAt": [0.0, 0.0, 0.0],
            },
            # The point size is scaled for a field of view of 90 degrees.
            "material": {
                "cls": "PointsMaterial",
                "size": size / float(np.tan(np.radians(_VIEW / 2))),
            },
        }
