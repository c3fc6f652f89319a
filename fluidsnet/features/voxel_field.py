"""Global feature that varies in space: a voxel field interpolated at the particles.

Beyond the paper, whose one vector is the same for all particles.
"""

from __future__ import annotations

import math
from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.errors import UserError
from fluidsnet.features.float32_linear import Float32Linear
from fluidsnet.features.global_feature import GlobalFeature
from fluidsnet.features.sparse_convolution import SparseConvolution
from fluidsnet.features.sparse_grid import SparseGrid
from fluidsnet.features.voxel import GridShape
from fluidsnet.particles import Particles
from fluidsnet.torch_extensions import gather_csr, segment_csr


@final
class VoxelField(GlobalFeature):
    """Means over cells, a sparse 3-D U-Net, and trilinear interpolation at each particle.

    Pressure acts over the whole depth of a fluid at once, which the coarse levels carry. The
    interpolation is continuous where a particle moves to another cell.

    Only cells around particles exist (`SparseGrid`), in a size that does not depend on the
    domain: time and memory follow the particles, and the weights are valid in any box. Cells
    are aligned to the lower corner of each frame's domain.

    A coarser cell has an eighth of the sum over the cells that it holds, so a cell that is
    partly filled differs from a full one. A finer cell gets the value of the cell that holds it;
    with the convolution that follows, the U-Net can learn any interpolation between them.

    Args:
        grid_shape: Not used; other global features are bound to the data's grid.
        inputs: Width of the particles' features.
        channels: Channels of the field, and width of the feature.
        levels: Levels of the U-Net, 1 to 8; each doubles the edge of a cell.
        cell_size: Edge of a finest cell, support radii.

    Raises:
        UserError: `levels` or `cell_size` is out of range.
    """

    knows_periodic = False

    def __init__(
        self,
        grid_shape: GridShape,
        inputs: int,
        channels: int = 24,
        levels: int = 3,
        cell_size: float = 1.0,
    ) -> None:
        super().__init__()
        if not 1 <= levels <= 8:
            raise UserError(f"VoxelField: levels is {levels}; set 1 to 8.")
        if not 0 < cell_size < math.inf:
            raise UserError(f"VoxelField: cell_size is {cell_size}; set a positive number.")
        self.width, self.cell_size = channels, cell_size
        self.encode = Float32Linear(inputs, channels)
        # One channel more than the mean features: the number of particles in the cell.
        self.enter = SparseConvolution(channels + 1, channels)
        self.down = nn.ModuleList(SparseConvolution(channels, channels) for _ in range(levels - 1))
        self.up = nn.ModuleList(
            SparseConvolution(2 * channels, channels) for _ in range(levels - 1)
        )

    def forward(self, particles: Particles, features: Tensor) -> Tensor:
        edge = self.cell_size * particles.scene.support_radius
        lower = particles.per_particle(particles.scene.domain_lower)
        grid = SparseGrid.around(
            (particles.position - lower) / edge,
            particles.frame,
            particles.frames,
            levels=1 + len(self.down),
        )
        # Sorted, so that sums over cells are in order, also on a GPU.
        encoded = torch.tanh(self.encode(features)).index_select(0, grid.order)
        finest = grid.levels[0]
        means = segment_csr(encoded, finest.offset, reduce="mean")
        per_full_cell = (edge / (2 * particles.scene.particle_radius)) ** 3
        filled = finest.offset.diff()[:, None] / per_full_cell
        field = self._convolve(torch.cat([means, filled], dim=1), grid)
        return grid.sample(field).to(features.dtype)

    def _convolve(self, rows: Tensor, grid: SparseGrid) -> Tensor:
        """Return the U-Net's output (C, channels) in the finest cells."""
        finest, *coarser = grid.levels
        skipped = [torch.tanh(self.enter(rows, finest.neighbor))]
        for convolution, level in zip(self.down, coarser, strict=True):
            pooled = segment_csr(skipped[-1], level.offset, reduce="sum") / 8
            skipped.append(torch.tanh(convolution(pooled, level.neighbor)))
        field = skipped.pop()
        for convolution, level in zip(self.up, reversed(coarser), strict=True):
            fine = skipped.pop()
            rows = torch.cat([gather_csr(field, level.offset), fine], dim=1)
            finer = grid.levels[len(skipped)]
            field = torch.tanh(convolution(rows, finer.neighbor))
        return field
