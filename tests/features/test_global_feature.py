from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import nn

from fluidsnet.errors import UserError
from fluidsnet.features import GlobalVector, NoGlobalFeature, VoxelFeature
from fluidsnet.features.global_feature import kernel_shapes
from fluidsnet.features.voxel import occupied_voxels
from fluidsnet.particles import Particles

Make = Callable[..., Particles]


@pytest.mark.parametrize(
    ("cells", "stack"),
    [
        ((21, 21, 21), [(2, 2, 2), (2, 2, 2), (2, 2, 2), (3, 3, 3)]),
        ((18, 12, 18), [(2, 2, 2), (3, 2, 3), (3, 3, 3)]),
    ],
)
def test_the_stacks_are_those_of_table_1(
    cells: tuple[int, int, int], stack: list[tuple[int, int, int]]
) -> None:
    assert kernel_shapes(cells) == stack


@pytest.mark.parametrize(
    "cells", [(1, 1, 1), (2, 1, 7), (24, 6, 24), (5, 17, 100), (1, 64, 65), (13, 13, 13)]
)
def test_every_stack_ends_in_one_cell(cells: tuple[int, int, int]) -> None:
    left = list(cells)
    for kernel in kernel_shapes(cells):
        assert set(kernel) <= {1, 2, 3}
        left = [-(-count // stride) for count, stride in zip(left, kernel, strict=True)]
    assert left == [1, 1, 1]


def test_the_weight_counts_that_tell_depthwise_stacks_apart() -> None:
    counts = {
        cells: sum(weight.numel() for weight in GlobalVector(cells, 16).stack.parameters())
        for cells in ((21, 21, 21), (18, 12, 18))
    }
    assert counts == {(21, 21, 21): 7040, (18, 12, 18): 7168}
    full = GlobalVector((18, 12, 18), 16, separable=False).stack.parameters()
    assert sum(weight.numel() for weight in full) == 128 * 7168 - 127 * 3 * 128


def test_cells_of_particles_against_a_loop(make_particles: Make) -> None:
    particles = make_particles((60, 0), (40, 0))
    particles.position[0] = torch.tensor([-5.0, 0.5, 99.0])
    shape = (6, 4, 5)
    found = occupied_voxels(particles, shape)
    lower, extent = particles.scene.domain_lower[0], particles.scene.extent[0]
    for row, (position, frame) in enumerate(zip(particles.position, particles.frame, strict=True)):
        number = int(frame)
        for axis, count in enumerate(shape):
            place = float((position[axis] - lower[axis]) / extent[axis]) * count
            number = number * count + min(max(int(place // 1), 0), count - 1)
        assert int(found.cell[found.index[row]]) == number
    assert len(found.cell) == len(found.index.unique())


def test_voxel_feature_against_a_loop(make_particles: Make) -> None:
    torch.manual_seed(1)
    particles = make_particles((80, 0), (50, 0))
    features = torch.randn(130, 16, device=particles.position.device)
    voxel = VoxelFeature(16).to(features.device).eval()
    cells = occupied_voxels(particles, (3, 2, 3))
    expected = []
    for cell in range(len(cells.cell)):
        inside = features[cells.index == cell]
        for layer in voxel.layers:
            own = torch.tanh(layer.norm(layer.linear(inside)))
            inside = torch.cat([own, own.mean(dim=0).expand_as(own)], dim=1)
        expected.append(inside.mean(dim=0))
    assert torch.allclose(voxel(features, cells), torch.stack(expected), atol=1e-5)


def test_global_vector_against_a_plain_network(make_particles: Make) -> None:
    torch.manual_seed(2)
    particles = make_particles((90, 0), (40, 0))
    features = torch.randn(130, 16, device=particles.position.device)
    cells = (5, 4, 7)
    context = GlobalVector(cells, 16).to(features.device).eval()
    occupied = occupied_voxels(particles, cells)
    voxels = context.voxel(features, occupied)
    grid = torch.stack([context.empty, context.empty]).flatten(0, 1).clone()
    for row, cell in enumerate(occupied.cell):
        grid[cell] = voxels[row]
    vectors = []
    for frame in grid.view(2, *cells, 128):
        volume = frame.permute(3, 0, 1, 2)[None]
        for convolution in context.stack:
            strides = convolution.stride
            padding = [
                -size % stride for size, stride in zip(volume.shape[2:], strides, strict=True)
            ]
            volume = nn.functional.pad(volume, [0, padding[2], 0, padding[1], 0, padding[0]])
            volume = torch.tanh(convolution(volume))
        assert volume.shape[2:] == (1, 1, 1)
        vectors.append(context.reduce(volume.flatten()))
    expected = torch.stack(vectors)[particles.frame]
    assert torch.allclose(context(particles, features), expected, atol=1e-5)
    assert context(particles, features).shape == (130, 32)


def test_empty_cells_are_random_in_training_and_fixed_in_evaluation(make_particles: Make) -> None:
    particles = make_particles((30, 0))
    features = torch.randn(30, 16, device=particles.position.device)
    first, second = (GlobalVector((18, 12, 18), 16).to(features.device) for _ in range(2))
    assert torch.equal(first.empty, second.empty)
    assert float(first.empty.var()) == pytest.approx(0.01, rel=0.02)
    assert float(first.empty.mean()) == pytest.approx(0.0, abs=0.001)
    first.eval()
    assert torch.equal(first(particles, features), first(particles, features))
    first.train()
    assert not torch.equal(first(particles, features), first(particles, features))


def test_empty_cells_are_not_in_the_checkpoint() -> None:
    assert not any("empty" in name for name in GlobalVector((6, 4, 6), 16).state_dict())


def test_no_context_has_no_weights_and_no_width(make_particles: Make) -> None:
    context = NoGlobalFeature((6, 4, 6), 16)
    particles = make_particles((30, 0))
    assert context(particles, torch.randn(30, 16)).shape == (30, 0)
    assert not list(context.parameters())


def test_a_grid_that_does_not_fit_into_memory_is_refused() -> None:
    with pytest.raises(UserError, match=r"GlobalVector needs 32,768 GB for 1 grids of 4000 x 4000"):
        GlobalVector((4000, 4000, 4000), 16)


def test_a_grid_of_one_cell_is_warned_of() -> None:
    with pytest.warns(UserWarning, match=r"one cell.*lower data.voxel_size"):
        GlobalVector((1, 1, 1), 16)
