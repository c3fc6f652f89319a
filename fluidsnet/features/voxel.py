"""Voxel feature: the particles in a cell of the background grid (section 4.4, figure 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.features.norm import BatchNorm
from fluidsnet.kernels import use_kernel
from fluidsnet.kernels.voxel_means import voxel_means
from fluidsnet.particles import Particles
from fluidsnet.torch_extensions import gather_csr, segment_csr

#: Number of cells of the background grid along x, y and z.
GridShape = tuple[int, int, int]


@dataclass(frozen=True)
class OccupiedVoxels:
    """Occupied cells of a batch of frames.

    Attributes:
        cell: (C,) int64, index of each occupied cell among all frames' cells; ascending.
        index: (N,) int64, row of `cell` for each fluid particle.
        offset: (C + 1,) int64, cell c has the particles offset[c] to offset[c + 1] of `order`.
    """

    cell: Tensor
    index: Tensor
    offset: Tensor

    @cached_property
    def order(self) -> Tensor:
        """(N,) int64, rows of the particles, sorted by cell."""
        # 32 bits are sorted in half the time of 64.
        return self.index.int().argsort(stable=True)


def occupied_voxels(particles: Particles, shape: GridShape) -> OccupiedVoxels:
    """Sort the fluid particles into the grid over the domain.

    A particle outside the domain counts for the nearest cell at the border. Cells are indexed
    by frame, x, y and z, the last fastest.

    Args:
        particles: N fluid particles.
        shape: Number of cells along x, y, z; the same for a scaled scene.
    """
    scene = particles.scene
    counts = tuple(float(count) for count in shape)
    lower, extent = map(particles.per_particle, (scene.domain_lower, scene.extent))
    position = (particles.position - lower) / extent
    x, y, z = (
        # A particle whose position is NaN counts for the first cell.
        (torch.nan_to_num(position[:, axis]) * counts[axis]).clamp(0, counts[axis] - 1).long()
        for axis in range(3)
    )
    voxel = ((particles.frame * shape[0] + x) * shape[1] + y) * shape[2] + z
    occupancy = torch.bincount(voxel, minlength=particles.frames * shape[0] * shape[1] * shape[2])
    cell = occupancy.nonzero().squeeze(1)
    index = ((occupancy > 0).cumsum(0) - 1).index_select(0, voxel)
    return OccupiedVoxels(cell, index, nn.functional.pad(occupancy[cell].cumsum(0), (1, 0)))


@final
class VoxelFeatureLayer(nn.Module):
    """Linear, batch norm and tanh, concatenated with the mean over the cell.

    The two halves are kept apart, since the second is the same for all particles of a cell.

    Args:
        inputs: Input width.
        outputs: Output width; one half per particle, the other per cell.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, outputs // 2)
        self.norm = BatchNorm(outputs // 2)

    def forward(self, own: Tensor, shared: Tensor, offset: Tensor) -> tuple[Tensor, Tensor]:
        """Return outputs of the particles (N, outputs / 2) and cells (C, outputs / 2).

        Args:
            own: (N, I) inputs of the particles, sorted by cell.
            shared: (C, inputs - I) inputs of the cells.
            offset: (C + 1,) first particle of each cell.
        """
        weight = self.linear.weight
        per_cell = nn.functional.linear(shared, weight[:, own.shape[1] :], self.linear.bias)
        # Unlike plain indexing, gather_csr has a backward pass that sums rows in order.
        values = own @ weight[:, : own.shape[1]].T + gather_csr(per_cell, offset)
        own = torch.tanh(self.norm(values))
        return own, segment_csr(own, offset, reduce="mean")

    def folded(self) -> tuple[Tensor, Tensor]:
        """Return weight and bias of linear map and evaluation batch norm in one."""
        norm = self.norm
        assert norm.running_mean is not None and norm.running_var is not None
        scale = norm.weight / (norm.running_var + norm.eps).sqrt()
        bias = (self.linear.bias - norm.running_mean) * scale + norm.bias
        return self.linear.weight * scale[:, None], bias


@final
class VoxelFeature(nn.Module):
    """Vector of each occupied cell, computed from all particles in it.

    Args:
        inputs: Width of the particles' features.
        widths: Output widths of the layers (Table 1: 32, 64, 128).
    """

    def __init__(self, inputs: int, widths: Sequence[int] = (32, 64, 128)) -> None:
        super().__init__()
        self.width = widths[-1]
        self.layers = nn.ModuleList(
            VoxelFeatureLayer(before, after)
            for before, after in zip([inputs, *widths[:-1]], widths, strict=True)
        )

    def forward(self, features: Tensor, cells: OccupiedVoxels) -> Tensor:
        """Return (C, width) for features (N, inputs) of the particles."""
        if not self.training and use_kernel(self, features):
            layers = [layer.folded() for layer in self.layers]  # type: ignore[operator]
            return voxel_means(features, cells.order, cells.offset, layers)
        own = features.index_select(0, cells.order)
        # The first layer has no input per cell.
        shared = own.new_empty(len(cells.cell), 0)
        # Float32, since a bfloat16 sum stops growing at 256 times its addends.
        with torch.autocast(features.device.type, enabled=False):
            for layer in self.layers:
                own, shared = layer(own, shared, cells.offset)
        # The mean of the shared half over a cell is the shared half.
        return torch.cat([shared, shared], dim=1)
