"""Velocities as differences of positions, where data has none."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from datamodules.convert.simulation import Array
from fluidsnet.errors import UserError


def with_velocities(
    positions: Iterable[Array], interval: float, periods: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield positions with their velocities, vₜ = (xₜ - xₜ₋₁) / Δt.

    This inverts symplectic Euler, x' = x + Δt·v', as LagrangeBench does. The first frame has no
    predecessor; it gets the velocity of the second. Along a periodic axis the difference is that
    to the nearest image.

    Args:
        positions: (N, 3) of each frame, m.
        interval: Time between two frames, Δt, s.
        periods: (3,) lengths of the periodic axes, m; 0 along the others.

    Raises:
        UserError: There is one frame only, or the number of particles changes.
    """
    periodic, before = periods > 0, None
    for index, position in enumerate(positions):
        if before is None:
            before = position
            continue
        if len(before) != len(position):
            raise UserError(
                f"the number of particles changes from {len(before)} to {len(position)} at frame "
                f"{index}; inlets, outlets and emitters are not supported, so leave the "
                "simulation out."
            )
        step = position.astype(np.float64) - before
        step[:, periodic] -= periods[periodic] * np.round(step[:, periodic] / periods[periodic])
        velocity = (step / interval).astype(np.float32)
        if index == 1:
            yield before, velocity
        yield position, velocity
        before = position
    if before is not None and index == 0:
        raise UserError("it has one frame and no velocities; differences need at least two frames.")
