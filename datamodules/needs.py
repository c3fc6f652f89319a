"""What a model has to know of the scenes before it is built."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from fluidsnet.errors import UserError
from fluidsnet.scene import VALUES, Scene

#: Most cells of a background grid; each has 128 numbers.
MOST_CELLS = 50_000_000


def grid_shape(scene: Scene, voxel_size: float) -> tuple[int, int, int]:
    """Return the fewest cells along x, y and z that cover a scene's domain; one along a flat axis.

    Args:
        scene: Scene; the domain of its first frame counts.
        voxel_size: Edge of a cell, m.

    Raises:
        UserError: There would be more than `MOST_CELLS`.
    """
    # The tolerance keeps 1.5 / 0.1 from becoming 16 by rounding.
    x, y, z = (max(math.ceil(edge / voxel_size - 1e-4), 1) for edge in scene.edges[0])
    shape = x, y, z if scene.dimension == 3 else 1
    if math.prod(shape) > MOST_CELLS:
        raise UserError(
            f"data.voxel_size is {voxel_size:g} m, which gives {x:,} x {y:,} x {shape[2]:,} cells "
            f"in a box of {' x '.join(f'{edge:g}' for edge in scene.edges[0])} m; set a larger "
            "one, of a few support radii. Lengths in data files are in m."
        )
    return shape


def varying(scenes: Sequence[Scene]) -> list[str]:
    """Return the names of the `fluidsnet.scene.VALUES` that differ between scenes."""
    columns = torch.cat([scene.values for scene in scenes])
    differs = (~torch.isclose(columns, columns[:1])).any(dim=0).tolist()
    names = [name for name, width in VALUES.items() for _ in range(width)]
    return list(dict.fromkeys(it for it, on in zip(names, differs, strict=True) if on))
