"""The voxel feature: what happens in a cell of the background grid (section 4.4, figure 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import torch
from torch import Tensor, nn
from torch_scatter import gather_csr, segment_csr

from fluidsnet.features.dense import compiled_path_for
from fluidsnet.features.fused_voxel import cell_means
from fluidsnet.features.norm import BatchNorm
from fluidsnet.particles import Particles

#: Number of cells of the background grid along x, y and z.
GridShape = tuple[int, int, int]


@dataclass(frozen=True)
class OccupiedVoxels:
    """The occupied cells of a batch of frames.

    Attributes:
        cell: (C,) int64, number of each occupied cell among all frames' cells; ascending.
        index: (N,) int64, row of `cell` that a fluid particle lies in.
        offset: (C + 1,) int64, cell c has the particles offset[c] to offset[c + 1] of `order`.
    """

    cell: Tensor
    index: Tensor
    offset: Tensor

    @cached_property
    def order(self) -> Tensor:
        """(N,) int64, rows of the particles, one cell's after another's."""
        # 32 bits, which are sorted in half the time.
        return self.index.int().argsort(stable=True)


def occupied_voxels(particles: Particles, shape: GridShape) -> OccupiedVoxels:
    """Sorts the fluid particles into the grid over the domain.

    A particle outside the domain counts for the cell at the border that is nearest. OccupiedVoxels
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
    crowd = torch.bincount(number, minlength=particles.frames * shape[0] * shape[1] * shape[2])
    cell = crowd.nonzero().squeeze(1)
    index = ((crowd > 0).cumsum(0) - 1).index_select(0, number)
    return OccupiedVoxels(cell, index, nn.functional.pad(crowd[cell].cumsum(0), (1, 0)))


@final
class VoxelFeatureLayer(nn.Module):
    """Linear, batch norm, tanh; beside each particle's result, the mean over its cell.

    The next layer takes both side by side. What it makes of the mean is the same for all of a
    cell's particles, so the two stay apart and nothing is repeated for each particle.

    Args:
        inputs: width in.
        outputs: width out; half of it each particle's own, half its cell's.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, outputs // 2)
        self.norm = BatchNorm(outputs // 2)

    def forward(self, own: Tensor, shared: Tensor, offset: Tensor) -> tuple[Tensor, Tensor]:
        """The particles' own results, (N, outputs / 2), and their cells' means, (C, outputs / 2).

        Args:
            own: (N, I) of the particles, one cell's after another's.
            shared: (C, inputs - I) of the cells.
            offset: (C + 1,) where the cells begin.
        """
        weight = self.linear.weight
        of_cells = nn.functional.linear(shared, weight[:, own.shape[1] :], self.linear.bias)
        # Unlike plain indexing, this has a backward pass that adds up rows in order.
        values = own @ weight[:, : own.shape[1]].T + gather_csr(of_cells, offset)
        own = torch.tanh(self.norm(values))
        return own, segment_csr(own, offset, reduce="mean")

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of the linear map with the batch norm of evaluation in them."""
        norm = self.norm
        assert norm.running_mean is not None and norm.running_var is not None
        scale = norm.weight / (norm.running_var + norm.eps).sqrt()
        bias = (self.linear.bias - norm.running_mean) * scale + norm.bias
        return self.linear.weight * scale[:, None], bias


@final
class VoxelFeature(nn.Module):
    """One vector for each occupied cell, from the particles in it.

    The work follows the particles and the occupied cells; no particle is dropped. In
    evaluation, without gradients and on the CPU, whole cells go through all layers in blocks
    that stay in the cache.

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

    def forward(self, features: Tensor, cells: OccupiedVoxels) -> Tensor:
        """(N, inputs) of the particles to (C, width) of the occupied cells."""
        if compiled_path_for(features) and not self.training:
            return cell_means(
                features,
                cells.order,
                cells.offset,
                [layer.folded() for layer in self.layers],  # type: ignore[operator]
            )
        own = features.index_select(0, cells.order)
        # The first layer has nothing of the cells yet.
        shared = own.new_empty(len(cells.cell), 0)
        # Places come in, and a sum of hundreds in bfloat16 would stop at 256 times its addends.
        with torch.autocast(features.device.type, enabled=False):
            for layer in self.layers:
                own, shared = layer(own, shared, cells.offset)
        # The mean over a cell of what its particles share is that itself.
        return torch.cat([shared, shared], dim=1)
