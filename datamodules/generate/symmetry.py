"""Mirror symmetries of a domain, to find starts that are the same simulation."""

from __future__ import annotations

from itertools import permutations, product
from typing import final

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.scenes import Body, Vector


@final
class Symmetries:
    """Mirrors and swaps of axes that map a box and gravity to themselves.

    Under gravity along y these are the mirrors of x and z, and, where the box is as wide as it
    is deep, their swap: the changes of `datamodules.augmentation.BoxSymmetry`.

    Args:
        domain: Edges of the box, m; its lower corner is the origin.
        gravity: m/s².
    """

    def __init__(self, domain: Vector, gravity: Vector) -> None:
        self._edges, pull = np.array(domain), np.array(gravity)
        # The first is the identity; `alike` relies on it.
        maps = [
            (axes, signs)
            for axes in permutations(range(3))
            for signs in product((1, -1), repeat=3)
            if np.allclose(self._edges[list(axes)], self._edges)
            and np.allclose(signs * pull[list(axes)], pull)
        ]
        self._axes = np.array([axes for axes, _ in maps])
        self._mirrors = np.array([signs for _, signs in maps]) < 0

    def _images(self, bodies: list[Body]) -> NDArray[np.float64]:
        """Return (S, B, 2, 3) lower and upper corners, m, of B bodies under S symmetries."""
        corners = np.array([body.bounds() for body in bodies])
        turned = np.moveaxis(corners[..., self._axes], 2, 0)
        mirrors = self._mirrors[:, None, None]
        return np.sort(np.where(mirrors, self._edges - turned, turned), axis=2)

    def alike(self, first: list[Body], second: list[Body], distance: float) -> bool:
        """Return True if a symmetry maps each body of one scene onto that of another.

        Their boxes may be less than `distance` apart, m. A mesh is taken to be symmetric, so
        different scenes may count as alike, but never the reverse.
        """
        if [_form(body) for body in first] != [_form(body) for body in second]:
            return False
        distances = np.abs(self._images(first) - self._images(second)[0])
        return bool((distances.max(axis=(1, 2, 3)) < distance).any())


def _form(body: Body) -> tuple[str, str | None]:
    return type(body).__name__, getattr(body, "mesh", None)
