"""What stands around the particles of a scene in TensorBoard's tab Mesh."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from fluidsnet.scene import Scene

# Dark, as the page behind is white, and so are the fastest particles.
_SHEET, _EDGE = (34, 42, 54), (109, 122, 140)  # red, green, blue
_VIEW = 40  # degrees from the picture's lower to its upper end
_MOST = 48  # points along an edge of a sheet

Floats = NDArray[np.float32]


@final
class MeshBackdrop:
    """The domain twice, side by side around the origin: floor, back wall and edges, of points.

    Attributes:
        points: (E, 3) m.
        colors: (E, 3) uint8, red, green, blue.
        shifts: from a position in the domain to its place in the left and in the right one, (3,) m.
        config: of the scene's camera and points, for `SummaryWriter.add_mesh`.

    Args:
        scene: whose domain it is.
    """

    def __init__(self, scene: Scene) -> None:
        self._lower: Floats = scene.domain_lower.cpu().numpy().astype(np.float32)
        self._width: Floats = scene.domain_upper.cpu().numpy().astype(np.float32) - self._lower
        apart: Floats = np.array([0.55 * self._width[0], 0, 0], np.float32)
        middle: Floats = self._lower + self._width / np.float32(2)
        self.shifts: tuple[Floats, Floats] = (-middle - apart, -middle + apart)
        # Smaller than the particles, or they would run together: points are not shaded.
        size = 1.7 * scene.particle_radius
        sheets, edges = self._sheets(size), self._edges()
        one = self._lower + np.concatenate([sheets, edges]) * self._width
        self.points: Floats = np.concatenate([one + shift for shift in self.shifts])
        colors = np.array([_SHEET] * len(sheets) + [_EDGE] * len(edges), np.uint8)
        self.colors: NDArray[np.uint8] = np.tile(colors, (2, 1))
        self.config = self._camera(size)

    def near(self, position: Floats) -> NDArray[np.bool_]:
        """Which particles are in the domain, or no farther from it than a quarter of its width.

        Args:
            position: (N, 3) m.

        Returns:
            (N,), false for what is not finite.
        """
        with np.errstate(invalid="ignore"):
            off: Floats = np.abs((position - self._lower) / self._width - 0.5)
            return np.asarray((off <= 0.75).all(axis=1))

    def _sheets(self, size: float) -> Floats:
        """Floor and back wall, as shares of the domain, (P, 3)."""
        x, y, z = (
            np.linspace(0, 1, int(np.clip(width / size, 2, _MOST)), dtype=np.float32)
            for width in self._width
        )
        floor = np.stack(np.meshgrid(x, [np.float32(0)], z), axis=-1).reshape(-1, 3)
        wall = np.stack(np.meshgrid(x, y, [np.float32(0)]), axis=-1).reshape(-1, 3)
        # A little outside, so that no particle is within.
        off = size / self._width
        floor[:, 1] -= off[1]
        wall[:, 2] -= off[2]
        return np.concatenate([floor, wall])

    def _edges(self) -> Floats:
        """The twelve edges, as shares of the domain, (P, 3)."""
        along = np.linspace(0, 1, _MOST)
        points = np.empty((3, 4, _MOST, 3), np.float32)
        for axis in range(3):
            for corner in range(4):
                points[axis, corner, :, axis] = along
                points[axis, corner, :, (axis + 1) % 3] = corner & 1
                points[axis, corner, :, (axis + 2) % 3] = corner >> 1
        return points.reshape(-1, 3)

    def _camera(self, size: float) -> dict[str, Any]:
        """In front and above; both domains fill a picture that is a little wider than high."""
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
            # Where points are drawn, a view of 90 degrees is taken for granted.
            "material": {
                "cls": "PointsMaterial",
                "size": size / float(np.tan(np.radians(_VIEW / 2))),
            },
        }
