"""The ``metadata.json`` of LagrangeBench."""

from __future__ import annotations

import json
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from fluidsnet.errors import UserError

_KEYS = ("dim", "dt", "bounds", "periodic_boundary_conditions")
_NUMBERS = ("dt", "dx", "write_every", "viscosity", "support_radius")


def read_metadata(path: Path) -> dict[str, Any]:
    """Read a ``metadata.json`` and check what a conversion uses of it.

    Raises:
        UserError: It is no JSON, lacks a key, or has a value that is not possible.
    """
    try:
        metadata: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: it cannot be read as JSON: {error}.") from error
    if missing := [key for key in _KEYS if key not in metadata]:
        raise UserError(
            f"{path}: {', '.join(missing)} is missing; LagrangeBench's metadata has it."
        )
    dimension, bounds = metadata["dim"], np.shape(metadata["bounds"])
    if dimension not in (2, 3) or bounds != (dimension, 2):
        raise UserError(
            f"{path}: dim is {dimension} and bounds has shape {bounds}; expected 2 or 3, and a "
            "pair for each axis."
        )
    for key in _NUMBERS:
        value = metadata.get(key, 1)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < inf:
            raise UserError(f"{path}: {key} is {value!r}; expected a number that is not negative.")
    return metadata
