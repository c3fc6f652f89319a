"""The colors of speed: blue at rest and whiter the faster, as in Fig. 12 of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

_SPEEDS = ("#0b2fc4", "#1f63ea", "#62a4f7", "#b9dcff", "#ffffff")  # at rest ... fastest


def speed_colormap() -> Colormap:
    """From 0, at rest, to 1, the fastest."""
    # Imported here: whoever only writes files need not wait for it.
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("speed", _SPEEDS)


def speed_scale(speeds: Sequence[NDArray[Any]]) -> float:
    """Where a scale common to several states ends, m/s: all but one particle in 200 are below.

    Args:
        speeds: (N,) m/s of each state; what is not finite is left out.
    """
    joined = np.concatenate([np.asarray(speed, float) for speed in speeds])
    joined = joined[np.isfinite(joined)]
    return max(float(np.quantile(joined, 0.995)), 1e-3) if joined.size else 1.0


def speed_colors(speed: NDArray[Any], top: float) -> NDArray[np.float64]:
    """Red, green and blue (N, 3), from 0 to 1.

    Args:
        speed: (N,), m/s.
        top: where the scale ends, m/s.
    """
    shares = np.nan_to_num(speed / top, nan=0.0, posinf=1.0)
    colors: NDArray[np.float64] = speed_colormap()(shares)[:, :3]
    return colors
