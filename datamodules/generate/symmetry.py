"""Mirror symmetries of scenes, to find starts that are the same simulation."""

from __future__ import annotations

from itertools import permutations, product
from typing import final

import numpy as np

from datamodules.generate.bodies import Vector, shape_and_mesh
from datamodules.generate.scenes import DrawnScene


@final
class Symmetries:
    """Mirrors and swaps of axes that map the gravity of one scene to that of another.

    Under gravity along y these are the mirrors of x and z, and their swap: the changes of
    `datamodules.augmentation.BoxSymmetry`.

    Args:
        gravity: m/s², of scenes without their own.
    """

    def __init__(self, gravity: Vector) -> None:
        self._gravity = gravity
        maps = [*product(permutations(range(3)), product((1, -1), repeat=3))]
        self._axes = np.array([axes for axes, _ in maps])
        self._signs = np.array([signs for _, signs in maps])

    def alike(self, first: DrawnScene, second: DrawnScene, distance: float) -> bool:
        """Return True if a symmetry maps the box and each body of one scene onto the other's.

        The edges of the boxes and the bounding boxes of the bodies may be less than `distance`
        apart, m. Rotations, velocities and viscosities are not compared, so different scenes may
        count as alike, but never the reverse. Scenes with different solids that move are not alike.
        """
        if first.solids != second.solids:
            return False
        if [*map(shape_and_mesh, first.bodies)] != [*map(shape_and_mesh, second.bodies)]:
            return False
        pull, other = (np.array(it.gravity or self._gravity) for it in (first, second))
        edges = np.array(first.domain)[self._axes]
        fits = (np.abs(edges - np.array(second.domain)) < distance).all(axis=1)
        fits &= np.isclose(self._signs * pull[self._axes], other, atol=1e-6).all(axis=1)
        if not fits.any():
            return False
        edges, axes, mirrors = edges[fits, None, None], self._axes[fits], self._signs[fits] < 0
        before, after = (
            np.array([body.bounds() for body in scene.bodies]) for scene in (first, second)
        )
        turned = np.moveaxis(before[..., axes], 2, 0)
        # (symmetries, bodies, 2, 3): lower and upper corners of the images.
        images = np.sort(np.where(mirrors[:, None, None], edges - turned, turned), axis=2)
        return bool((np.abs(images - after).max(axis=(1, 2, 3)) < distance).any())
