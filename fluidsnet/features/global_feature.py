"""Global feature: the whole scene around a particle (paper, sections 4.4 and 4.5)."""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import final

import torch
from torch import Tensor, nn
from torch.profiler import record_function

from fluidsnet.errors import UserError
from fluidsnet.features.float32_linear import float32_on_cpu
from fluidsnet.features.voxel import GridShape, OccupiedVoxels, VoxelFeature, occupied_voxels
from fluidsnet.memory import free_bytes
from fluidsnet.particles import Particles

# Bytes from which it is worth to ask how much memory is free.
_MUCH = 1e9


class GlobalFeature(nn.Module, ABC):
    """Feature of a particle's surroundings beyond its neighbors.

    Attributes:
        width: Number of columns of the feature.
        needs_its_grid: The weights fit only the grid shape they were trained on.
        one_a_frame: All particles of a frame have the same feature.
        knows_periodic: It takes scenes with periodic axes.
    """

    width: int
    needs_its_grid = False
    one_a_frame = False
    knows_periodic = True

    @abstractmethod
    def forward(self, particles: Particles, features: Tensor) -> Tensor:
        """Return the global feature (N, width) of the fluid particles.

        Args:
            particles: N fluid particles.
            features: (N, inputs) their input and local features.
        """


@final
class NoGlobalFeature(GlobalFeature):
    """Empty feature, no columns: the ablation "without global feature" (section 5.6, figure 12)."""

    width = 0

    def __init__(self, grid_shape: GridShape, inputs: int) -> None:
        super().__init__()

    def forward(self, particles: Particles, features: Tensor) -> Tensor:
        return features.new_empty(len(features), 0)


@final
class GlobalVector(GlobalFeature):
    """The paper's global feature: one vector for all particles of a scene (section 4.5).

    Voxel features fill a dense grid, random numbers its empty cells, and 3-D convolutions with
    kernel = stride shrink it to one cell. Two linear maps without activation reduce the vector
    ("strictly linear"). The convolutions are depthwise: the paper's two networks have 9,683 and
    9,811 weights, which differ by 128 as the depthwise stacks of Table 1 do (7,040 and 7,168).

    Args:
        grid_shape: Number of cells of the background grid along x, y, z.
        inputs: Width of the particles' features.
        voxel_widths: Widths of the voxel feature's layers.
        reduced: Widths of the two linear maps.
        separable: Use depthwise convolutions; full ones otherwise.
        empty_variance: Variance of the random numbers in empty cells, the paper's N(0, 10⁻²).
        seed: Seed of the empty cells in evaluation; in training they are drawn at each call.
    """

    needs_its_grid = True
    one_a_frame = True
    empty: Tensor

    def __init__(
        self,
        grid_shape: GridShape,
        inputs: int,
        voxel_widths: Sequence[int] = (32, 64, 128),
        reduced: Sequence[int] = (64, 32),
        separable: bool = True,
        empty_variance: float = 0.01,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.grid_shape = grid_shape
        self.voxel = VoxelFeature(inputs, voxel_widths)
        channels = self.voxel.width
        self._check_memory(1, torch.device("cpu"))
        if math.prod(grid_shape) == 1:
            warnings.warn(
                "GlobalVector has a grid of one cell, so it sees no more than means over all "
                "particles; lower data.voxel_size.",
                stacklevel=2,
            )
        self.stack = nn.ModuleList(
            nn.Conv3d(channels, channels, kernel, kernel, groups=channels if separable else 1)
            for kernel in kernel_shapes(grid_shape)
        )
        self.reduce = nn.Sequential(
            *(
                nn.Linear(before, after)
                for before, after in zip([channels, *reduced[:-1]], reduced, strict=True)
            )
        )
        self.width = reduced[-1]
        self.empty_deviation = empty_variance**0.5
        self.seed = seed
        noise = torch.randn(
            (grid_shape[0] * grid_shape[1] * grid_shape[2], channels),
            generator=torch.Generator("cpu").manual_seed(seed),
            device="cpu",
        )
        self.register_buffer("empty", noise * self.empty_deviation, persistent=False)

    def forward(self, particles: Particles, features: Tensor) -> Tensor:
        particles.scene.check_one_box(type(self).__name__)
        with record_function("voxel"):
            occupied = occupied_voxels(particles, self.grid_shape)
            voxels = self.voxel(features, occupied)
        with record_function("global"):
            # Back from mixed precision, since the gradient sums over a frame's particles.
            vectors = self._reduced(particles.frames, occupied, voxels).to(features.dtype)
        if particles.frames == 1:
            # Expanded, not copied for each particle.
            return vectors.expand(len(particles), -1)
        return vectors[particles.frame]

    def _reduced(self, frames: int, occupied: OccupiedVoxels, voxels: Tensor) -> Tensor:
        """Return one vector per frame, (F, width), from the features of the occupied cells."""
        self._check_memory(frames, voxels.device)
        grid = self._empty_grid(frames)
        # Channels last, so that a cell is one row.
        grid = grid.index_copy(0, occupied.cell, voxels.to(grid.dtype))
        volume = grid.view(frames, *self.grid_shape, -1).permute(0, 4, 1, 2, 3)
        with float32_on_cpu(volume):
            for convolution, kernel in zip(self.stack, kernel_shapes(self.grid_shape), strict=True):
                volume = torch.tanh(convolution(_padded(volume, kernel)))
        vectors: Tensor = self.reduce(volume.flatten(1))
        return vectors

    def _check_memory(self, frames: int, device: torch.device) -> None:
        """Check that the dense grid of a batch fits into memory.

        Raises:
            UserError: It does not.
        """
        needed = 4 * frames * math.prod(self.grid_shape) * self.voxel.width
        if needed > _MUCH and needed > (free := free_bytes(device)):
            shape = " x ".join(map(str, self.grid_shape))
            raise UserError(
                f"GlobalVector needs {needed / 1e9:,.0f} GB for {frames} grids of {shape} cells, "
                f"and {free / 1e9:,.0f} GB are free; raise data.voxel_size or lower batch_size."
            )

    def _empty_grid(self, frames: int) -> Tensor:
        if self.training:
            shape = (frames * len(self.empty), self.empty.shape[1])
            drawn = torch.randn(shape, device=self.empty.device, dtype=self.empty.dtype)
            return drawn.mul_(self.empty_deviation)
        return self.empty.repeat(frames, 1)


def kernel_shapes(grid_shape: GridShape) -> list[GridShape]:
    """Return the kernels, equal to the strides, that shrink a grid to one cell.

    Along each axis they are the 2s and 3s, ascending, with the smallest product that is not
    below the number of cells: 2·2·2·3 for 21, 2·3·3 for 18, 2·2·3 for 12, which are both columns
    of Table 1. Shorter axes end with ones.

    Args:
        grid_shape: Number of cells of the grid along x, y, z.
    """
    axes = [_factors(count) for count in grid_shape]
    depth = max(len(factors) for factors in axes)
    x, y, z = (factors + [1] * (depth - len(factors)) for factors in axes)
    return list(zip(x, y, z, strict=True))


def _factors(count: int) -> list[int]:
    exponents = range(count.bit_length() + 1)
    products = ((2**twos * 3**threes, twos, threes) for twos in exponents for threes in exponents)
    _, twos, threes = min(found for found in products if found[0] >= count)
    return [2] * twos + [3] * threes


def _padded(volume: Tensor, kernel: tuple[int, ...]) -> Tensor:
    """Pad each axis with zeros at its far end to a multiple of the stride."""
    padding: list[int] = []
    for size, stride in zip(reversed(volume.shape[2:]), reversed(kernel), strict=True):
        padding += [0, -size % stride]
    return nn.functional.pad(volume, padding) if any(padding) else volume
