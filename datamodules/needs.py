"""What a model has to know of the scenes before it is built."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from fluidsnet.scene import VALUES, Scene


def grid_shape(scene: Scene, voxel_size: float) -> tuple[int, int, int]:
    """Return the fewest cells along x, y and z that cover a scene's domain; one along a flat axis.

    Args:
        scene: Scene; the domain of its first frame counts.
        voxel_size: Edge of a cell, m.
    """
    # The tolerance keeps 1.5 / 0.1 from becoming 16 by rounding.
    x, y, z = (max(math.ceil(edge / voxel_size - 1e-4), 1) for edge in scene.edges[0])
    return x, y, z if scene.dimension == 3 else 1


def varying(scenes: Sequence[Scene]) -> list[str]:
    """Return the names of the `fluidsnet.scene.VALUES` that differ between scenes."""
    columns = torch.cat([scene.values for scene in scenes])
    differs = (~torch.isclose(columns, columns[:1])).any(dim=0).tolist()
    names = [name for name, width in VALUES.items() for _ in range(width)]
    return list(dict.fromkeys(it for it, on in zip(names, differs, strict=True) if on))
