"""What a particle knows of the rest of the scene."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import final

import torch
from torch import Tensor, nn
from torch.profiler import record_function

from fluidsnet.features.float32_linear import float32_on_cpu
from fluidsnet.features.voxel import GridShape, OccupiedVoxels, VoxelFeature, occupied_voxels
from fluidsnet.particles import Particles


class GlobalFeature(nn.Module, ABC):
    """A feature of a particle's wider surroundings.

    Attributes:
        width: of the feature.
        needs_its_grid: whether its weights fit only the number of cells they were trained on.
        one_a_frame: whether all particles of a frame have the same.
    """

    width: int
    needs_its_grid = False
    one_a_frame = False

    @abstractmethod
    def forward(self, particles: Particles, features: Tensor) -> Tensor:
        """The context (N, width) of the fluid particles.

        Args:
            particles: N fluid particles.
            features: (N, inputs) input and local features of them.
        """


@final
class NoGlobalFeature(GlobalFeature):
    """None at all: the ablation "without global feature" (section 5.6, figure 12).

    Neither the voxel feature nor the grid is made, since nothing would use them.
    """

    width = 0

    def __init__(self, grid_shape: GridShape, inputs: int) -> None:
        super().__init__()

    def forward(self, particles: Particles, features: Tensor) -> Tensor:
        return features.new_empty(len(features), 0)


@final
class GlobalVector(GlobalFeature):
    """The paper's: one vector for the whole scene, the same for each particle (section 4.5).

    Voxel features fill a dense grid, its empty cells get random numbers, and 3-D
    convolutions whose kernel is their stride shrink it to one cell. They are depthwise:
    the paper's weight counts of its two networks, 9,683 and 9,811, differ by 128, as the
    depthwise stacks of Table 1 do (7,040 and 7,168 weights), and no full ones.
    Two linear maps reduce the vector, without an activation ("strictly linear").

    Args:
        grid_shape: cells of the background grid.
        inputs: width of the particles' features.
        voxel_widths: of the voxel feature's layers.
        reduced: widths of the two linear maps.
        separable: depthwise convolutions; full ones otherwise.
        empty_variance: of the random numbers in empty cells, read from N(0, 10⁻²).
        seed: of the empty cells in evaluation; in training they are drawn afresh.
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
        self.stack = nn.ModuleList(
            nn.Conv3d(channels, channels, kernel, kernel, groups=channels if separable else 1)
            for kernel in kernels(grid_shape)
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
        with record_function("voxel"):
            occupied = occupied_voxels(particles, self.grid_shape)
            voxels = self.voxel(features, occupied)
        with record_function("global"):
            # Mixed precision ends here: the gradient adds up a frame's particles.
            vectors = self._reduced(particles.frames, occupied, voxels).to(features.dtype)
        if particles.frames == 1:
            # No copy for each particle.
            return vectors.expand(len(particles), -1)
        return vectors[particles.frame]

    def _reduced(self, frames: int, occupied: OccupiedVoxels, voxels: Tensor) -> Tensor:
        """One vector a frame, (F, width), from the features of the occupied cells."""
        grid = self._empty_grid(frames)
        # Cells first, channels last: one row a cell to write to.
        grid = grid.index_copy(0, occupied.cell, voxels.to(grid.dtype))
        volume = grid.view(frames, *self.grid_shape, -1).permute(0, 4, 1, 2, 3)
        with float32_on_cpu(volume):
            for convolution, kernel in zip(self.stack, kernels(self.grid_shape), strict=True):
                volume = torch.tanh(convolution(_padded(volume, kernel)))
        vectors: Tensor = self.reduce(volume.flatten(1))
        return vectors

    def _empty_grid(self, frames: int) -> Tensor:
        if self.training:
            shape = (frames * len(self.empty), self.empty.shape[1])
            drawn = torch.randn(shape, device=self.empty.device, dtype=self.empty.dtype)
            return drawn.mul_(self.empty_deviation)
        return self.empty.repeat(frames, 1)


def kernels(grid_shape: GridShape) -> list[GridShape]:
    """The kernels, equal to the strides, that shrink a grid to one cell.

    Along each axis they are the smallest product of twos and threes that covers it with
    ceiling division, in ascending order: 21 is covered by 2·2·2·3, 18 by 2·3·3, 12 by
    2·2·3, which are both columns of Table 1. A shorter axis ends with ones.

    Args:
        grid_shape: cells of the grid.
    """
    axes = [_factors(count) for count in grid_shape]
    depth = max(len(factors) for factors in axes)
    x, y, z = (factors + [1] * (depth - len(factors)) for factors in axes)
    return list(zip(x, y, z, strict=True))


def _factors(count: int) -> list[int]:
    best: tuple[int, int, int] | None = None
    for threes in range(count.bit_length() + 1):
        twos = 0
        while 2**twos * 3**threes < count:
            twos += 1
        product = 2**twos * 3**threes
        if best is None or product < best[0]:
            best = (product, twos, threes)
    assert best is not None
    return [2] * best[1] + [3] * best[2]


def _padded(volume: Tensor, kernel: tuple[int, ...]) -> Tensor:
    """Zeros at the far end of each axis that its stride does not divide."""
    padding: list[int] = []
    for size, stride in zip(reversed(volume.shape[2:]), reversed(kernel), strict=True):
        padding += [0, -size % stride]
    return nn.functional.pad(volume, padding) if any(padding) else volume
