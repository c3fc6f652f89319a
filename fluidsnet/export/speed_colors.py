"""Colormap of speed, from blue at rest to white, as in Fig. 12 of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

_COLORS = ("#0b2fc4", "#1f63ea", "#62a4f7", "#b9dcff", "#ffffff")  # at rest ... fastest


def speed_colormap() -> Colormap:
    """Return the colormap, from 0, at rest, to 1, the fastest."""
    # Imported here because matplotlib is slow to import.
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("speed", _COLORS)


def speed_scale(speeds: Sequence[NDArray[Any]]) -> float:
    """Return the upper end of a common scale, m/s: the 99.5th percentile of all speeds.

    Args:
        speeds: (N,) m/s of each state; values that are not finite are ignored.
    """
    joined = np.concatenate([np.asarray(speed, float) for speed in speeds])
    joined = joined[np.isfinite(joined)]
    return max(float(np.quantile(joined, 0.995)), 1e-3) if joined.size else 1.0


def speed_colors(speed: NDArray[Any], top: float) -> NDArray[np.float64]:
    """Return red, green and blue (N, 3), from 0 to 1.

    Args:
        speed: (N,), m/s.
        top: Upper end of the scale, m/s.
    """
    shares = np.nan_to_num(speed / top, nan=0.0, posinf=1.0)
    colors: NDArray[np.float64] = speed_colormap()(shares)[:, :3]
    return colors
