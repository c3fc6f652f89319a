"""Which starts are one and the same simulation, seen in a mirror."""

from __future__ import annotations

from itertools import permutations, product
from typing import final

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.scenes import Body, Vector


@final
class Symmetries:
    """The mirrors and swaps of axes that map a box to itself and leave gravity as it is.

    Under gravity along y these are the mirrors of x and z, and, where the box is as wide as it
    is deep, their swap: what `datamodules.augmentation.BoxSymmetry` does to a sample.

    Args:
        domain: edges of the box, m; its lower corner is the origin.
        gravity: m/s².
    """

    def __init__(self, domain: Vector, gravity: Vector) -> None:
        self._edges, pull = np.array(domain), np.array(gravity)
        # The first does nothing.
        maps = [
            (axes, signs)
            for axes in permutations(range(3))
            for signs in product((1, -1), repeat=3)
            if np.allclose(self._edges[list(axes)], self._edges)
            and np.allclose(signs * pull[list(axes)], pull)
        ]
        self._axes = np.array([axes for axes, _ in maps])
        self._mirrors = np.array([signs for _, signs in maps]) < 0

    def images(self, bodies: list[Body]) -> NDArray[np.float64]:
        """The boxes around the bodies in each mirror.

        Args:
            bodies: of a scene.

        Returns:
            (S, B, 2, 3): lower and upper corner, m, of B bodies in S mirrors.
        """
        corners = np.array([body.bounds() for body in bodies])
        turned = np.moveaxis(corners[..., self._axes], 2, 0)
        mirrors = self._mirrors[:, None, None]
        return np.sort(np.where(mirrors, self._edges - turned, turned), axis=2)

    def alike(self, first: list[Body], second: list[Body], distance: float) -> bool:
        """Whether some mirror brings each body of one scene onto its like in another.

        A mesh counts as its own mirror image, so that too much is called alike, never too little.

        Args:
            first: the bodies of a scene.
            second: those of another.
            distance: m by which the corners of two boxes may differ and be the same.
        """
        if [_form(body) for body in first] != [_form(body) for body in second]:
            return False
        apart = np.abs(self.images(first) - self.images(second)[0])
        return bool((apart.max(axis=(1, 2, 3)) < distance).any())


def _form(body: Body) -> tuple[str, str | None]:
    return type(body).__name__, getattr(body, "mesh", None)
