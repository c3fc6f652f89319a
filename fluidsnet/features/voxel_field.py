"""Global feature that varies in space: a voxel field interpolated at the particles.

Beyond the paper, whose one vector is the same for all particles.
"""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor, nn
from torch_scatter import scatter

from fluidsnet.features.float32_linear import Float32Linear, float32_on_cpu
from fluidsnet.features.global_feature import GlobalFeature
from fluidsnet.features.voxel import GridShape, occupied_voxels
from fluidsnet.particles import Particles


@final
class VoxelField(GlobalFeature):
    """Means over cells, a 3-D U-Net, and trilinear interpolation at each particle.

    Pressure acts over the whole depth of a fluid at once, which the coarse levels carry. The
    interpolation is continuous where a particle moves to another cell.

    Args:
        grid_shape: Number of cells of the finest grid along x, y, z.
        inputs: Width of the particles' features.
        channels: Channels of the field, and width of the feature.
        levels: Levels of the U-Net; each halves the grid.
    """

    def __init__(
        self, grid_shape: GridShape, inputs: int, channels: int = 24, levels: int = 3
    ) -> None:
        super().__init__()
        self.grid_shape, self.width = grid_shape, channels
        self.encode = Float32Linear(inputs, channels)
        # One channel more than the mean features: the number of particles in the cell.
        self.enter = nn.Conv3d(channels + 1, channels, 3, padding=1)
        self.down = nn.ModuleList(
            nn.Conv3d(channels, channels, 3, padding=1) for _ in range(levels - 1)
        )
        self.up = nn.ModuleList(
            nn.Conv3d(2 * channels, channels, 3, padding=1) for _ in range(levels - 1)
        )

    def forward(self, particles: Particles, features: Tensor) -> Tensor:
        occupied = occupied_voxels(particles, self.grid_shape)
        encoded = torch.tanh(self.encode(features))
        ones = encoded.new_ones(len(encoded), 1)
        means = scatter(encoded, occupied.index, dim=0, dim_size=len(occupied.cell), reduce="mean")
        counts = scatter(ones, occupied.index, dim=0, dim_size=len(occupied.cell), reduce="sum")
        expected = self._particles_per_full_cell(particles)
        rows = torch.cat([means, counts / expected], dim=1)
        x, y, z = self.grid_shape
        grid = rows.new_zeros(particles.frames * x * y * z, rows.shape[1])
        grid = grid.index_copy(0, occupied.cell, rows)
        volume = grid.view(particles.frames, x, y, z, -1).permute(0, 4, 1, 2, 3)
        with float32_on_cpu(volume):
            field = self._convolve(volume)
        return self._sample(field, particles)

    def _particles_per_full_cell(self, particles: Particles) -> Tensor:
        scene = particles.scene
        volume = scene.extent.prod() / (
            self.grid_shape[0] * self.grid_shape[1] * self.grid_shape[2]
        )
        return volume / (2 * scene.particle_radius) ** 3

    def _convolve(self, volume: Tensor) -> Tensor:
        fine = [torch.tanh(self.enter(volume))]
        for convolution in self.down:
            coarse = nn.functional.avg_pool3d(fine[-1], 2, ceil_mode=True)
            fine.append(torch.tanh(convolution(coarse)))
        field = fine.pop()
        for convolution in self.up:
            skipped = fine.pop()
            spread = nn.functional.interpolate(
                field, size=skipped.shape[2:], mode="trilinear", align_corners=False
            )
            field = torch.tanh(convolution(torch.cat([spread, skipped], dim=1)))
        return field

    def _sample(self, field: Tensor, particles: Particles) -> Tensor:
        """Interpolate a field (F, C, X, Y, Z) between cell centers at the particles, (N, C)."""
        scene = particles.scene
        # Back from mixed precision, since the gradient sums over a cell's particles.
        rows = field.permute(0, 2, 3, 4, 1).flatten(0, 3).to(particles.position.dtype)
        base = particles.frame * (self.grid_shape[0] * self.grid_shape[1] * self.grid_shape[2])
        position = torch.nan_to_num((particles.position - scene.domain_lower) / scene.extent)
        lower, upper, fraction = [], [], []
        for axis, count in enumerate(self.grid_shape):
            coordinate = (position[:, axis] * count - 0.5).clamp(0, count - 1)
            first = coordinate.floor()
            fraction.append(coordinate - first)
            lower.append(first.long())
            upper.append((first.long() + 1).clamp_max(count - 1))
        result = torch.zeros_like(rows[base])
        for corner in range(8):
            weight, row = torch.ones_like(fraction[0]), torch.zeros_like(base)
            for axis, count in enumerate(self.grid_shape):
                far = bool(corner >> axis & 1)
                row = row * count + (upper if far else lower)[axis]
                weight = weight * (fraction[axis] if far else 1 - fraction[axis])
            result = result + rows[base + row] * weight[:, None]
        return result
