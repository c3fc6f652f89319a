"""Values of a file as tensors: any type and byte order, finite, and near zero."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datamodules.schema import GREATEST, SceneAttributes
from fluidsnet.errors import UserError

Vector = tuple[float, float, float]

NO_ORIGIN: Vector = (0.0, 0.0, 0.0)

# Distance of two neighboring float32 numbers, in particle radii, from which coordinates count as
# far from zero.
_COARSE = 1e-3


def origin_of(scene: SceneAttributes, particle_radius: float) -> Vector:
    """Return the point that positions are read relative to, m: zero, or a far box's lower corner.

    At 10⁶ m, as in map coordinates, float32 tells places apart by 6 cm only.

    Args:
        scene: Scene of a simulation.
        particle_radius: m.
    """
    farthest = np.abs([scene.domain_lower, scene.domain_upper]).max()
    if rounding(farthest) <= _COARSE * particle_radius:
        return NO_ORIGIN
    return scene.domain_lower


def rounding(value: float) -> float:
    """Return the distance from a number to the next one in float32."""
    return float(np.spacing(np.float32(value)))


def as_tensor(values: NDArray[Any], origin: Vector = NO_ORIGIN) -> Tensor:
    """Return values (..., 3) less an origin as float32.

    The difference is formed before anything is rounded.

    Args:
        values: Real numbers of any type and byte order.
        origin: m.
    """
    if origin != NO_ORIGIN:
        values = values.astype(np.float64) - np.array(origin)
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))


def check_finite(values: Tensor, path: object, name: str, what: str) -> None:
    """Check that values of a file are finite, and not so large that a step is not.

    Args:
        values: Values.
        path: File, for the message.
        name: Data set.
        what: Place in the file, such as "frame 3 of /00000".

    Raises:
        UserError: One is not.
    """
    # Not a number is not below it either.
    usable = values.abs() <= GREATEST
    if not bool(usable.all()):
        count = int((~usable).sum())
        raise UserError(
            f"{path}: {count} of the numbers of {name} in {what} are not finite, or beyond "
            f"{GREATEST:g}; leave such frames out with data.frame_range, or write the file again "
            "without them. `fluidsnet inspect` lists them."
        )
