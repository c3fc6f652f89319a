"""The voxel feature: what happens in a cell of the background grid (section 4.4, figure 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import torch
from torch import Tensor, nn
from torch_scatter import scatter

from fluidsnet.particles import Particles

#: Number of cells of the background grid along x, y and z.
GridShape = tuple[int, int, int]


@dataclass(frozen=True)
class Cells:
    """The occupied cells of a batch of frames.

    Attributes:
        cell: (C,) int64, number of each occupied cell among all frames' cells; ascending.
        index: (N,) int64, row of `cell` that a fluid particle lies in.
    """

    cell: Tensor
    index: Tensor


def occupied_cells(particles: Particles, shape: GridShape) -> Cells:
    """Sorts the fluid particles into the grid over the domain.

    A particle outside the domain counts for the cell at the border that is nearest. Cells
    are numbered frame by frame, then along x, y and z, the last fastest.

    Args:
        particles: N fluid particles.
        shape: of the grid; a scaled scene keeps it, and its cells grow.
    """
    scene = particles.scene
    counts = tuple(float(count) for count in shape)
    place = (particles.position - scene.domain_lower) / scene.extent
    x, y, z = (
        # A particle that is not finite has no cell of its own; it is put into the first.
        (torch.nan_to_num(place[:, axis]) * counts[axis]).clamp(0, counts[axis] - 1).long()
        for axis in range(3)
    )
    number = ((particles.frame * shape[0] + x) * shape[1] + y) * shape[2] + z
    cell, index = torch.unique(number, return_inverse=True)
    return Cells(cell, index)


@final
class VoxelFeatureLayer(nn.Module):
    """Linear, batch norm, tanh; beside each particle's result, the mean over its cell.

    Args:
        inputs: width in.
        outputs: width out; half of it each particle's own, half its cell's.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, outputs // 2)
        self.norm = nn.BatchNorm1d(outputs // 2)

    def forward(self, features: Tensor, cells: Cells) -> Tensor:
        """(N, inputs) to (N, outputs)."""
        own = torch.tanh(self._normalised(self.linear(features)))
        mean = scatter(own, cells.index, dim=0, dim_size=len(cells.cell), reduce="mean")
        return torch.cat([own, mean[cells.index]], dim=1)

    def _normalised(self, values: Tensor) -> Tensor:
        if self.training and len(values) < 2:
            # One particle has no variance; the running statistics serve.
            return nn.functional.batch_norm(
                values,
                self.norm.running_mean,
                self.norm.running_var,
                self.norm.weight,
                self.norm.bias,
            )
        normalised: Tensor = self.norm(values)
        return normalised


@final
class VoxelFeature(nn.Module):
    """One vector for each occupied cell, from the particles in it.

    The work follows the particles and the occupied cells; no particle is dropped.

    Args:
        inputs: width of the particles' features.
        widths: of the layers' outputs (Table 1: 32, 64, 128).
    """

    def __init__(self, inputs: int, widths: Sequence[int] = (32, 64, 128)) -> None:
        super().__init__()
        self.width = widths[-1]
        self.layers = nn.ModuleList(
            VoxelFeatureLayer(before, after)
            for before, after in zip([inputs, *widths[:-1]], widths, strict=True)
        )

    def forward(self, features: Tensor, cells: Cells) -> Tensor:
        """(N, inputs) of the particles to (C, width) of the occupied cells."""
        for layer in self.layers:
            features = layer(features, cells)
        pooled: Tensor = scatter(
            features, cells.index, dim=0, dim_size=len(cells.cell), reduce="mean"
        )
        return pooled
