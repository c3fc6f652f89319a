"""Positions in the coordinates of the data file, and what trajectory files say of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from fluidsnet.particles import Particles
from fluidsnet.scene import Scene


def file_places(position: Tensor, state: Particles) -> NDArray[Any]:
    """Return positions of a state in the coordinates of its file, (N, 3) m.

    They are float64 where the file has a box far from zero.

    Args:
        position: (N, 3) m, relative to the origin of the state's scene.
        state: State of one frame.
    """
    local: NDArray[Any] = position.cpu().numpy()
    origins = state.scene.origins
    if not origins or not any(origins[0]):
        return local
    placed: NDArray[Any] = local.astype(np.float64) + np.array(origins[0])
    return placed


def file_attributes(scene: Scene) -> dict[str, ArrayLike]:
    """Return what a trajectory file says of a scene of one frame, for other programs."""
    return {
        "particle_radius": scene.particle_radius,
        "gravity": scene.gravity[0].tolist(),
        "dimension": scene.dimension,
    }
