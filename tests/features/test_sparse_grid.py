"""The sparse grid against dictionaries of cells, and its convolution against a dense one."""

from __future__ import annotations

from itertools import product

import pytest
import torch
from torch import Tensor, nn

from fluidsnet.features.morton import coordinate_bits, encode, keys_around
from fluidsnet.features.sparse_convolution import SparseConvolution
from fluidsnet.features.sparse_grid import SparseGrid

Cell = tuple[int, int, int, int]


def random_positions(device: torch.device, scale: float = 7.0) -> tuple[Tensor, Tensor]:
    """Positions on both sides of the origin, and frames of which the second is empty."""
    generator = torch.Generator("cpu").manual_seed(0)
    position = scale * (torch.rand(90, 3, generator=generator, dtype=torch.float64) - 0.5)
    frame = torch.tensor([0] * 50 + [2] * 40)
    return position.to(device), frame.to(device)


def morton_order(cells: set[Cell]) -> list[Cell]:
    """Sort cells (frame, x, y, z) by frame, then by alternating bits of z, y and x."""

    def key(cell: Cell) -> tuple[int, str]:
        frame, *coordinates = cell
        bits = [f"{coordinate + 2**12:013b}" for coordinate in reversed(coordinates)]
        return frame, "".join(map("".join, zip(*bits, strict=True)))

    return sorted(cells, key=key)


def expected_levels(position: Tensor, frame: Tensor, count: int) -> list[list[Cell]]:
    """Cells (frame, x, y, z) of each level in Morton order."""
    finest: set[Cell] = set()
    for number, place in zip(frame.tolist(), position.tolist(), strict=True):
        lower = [int((coordinate - 0.5) // 1) for coordinate in place]
        finest |= {
            (number, lower[0] + i, lower[1] + j, lower[2] + k)
            for i, j, k in product(range(2), repeat=3)
        }
    levels = [finest]
    for _ in range(count - 1):
        levels.append({(f, x // 2, y // 2, z // 2) for f, x, y, z in levels[-1]})
    return list(map(morton_order, levels))


def around(cell: Cell) -> list[Cell]:
    frame, x, y, z = cell
    return [(frame, x + i, y + j, z + k) for k, j, i in product((-1, 0, 1), repeat=3)]


@pytest.mark.parametrize("count", [1, 2, 4])
def test_cells_and_their_neighbors_are_those_of_a_dictionary(
    count: int, device: torch.device
) -> None:
    position, frame = random_positions(device)
    grid = SparseGrid.around(position, frame, 3, count)
    levels = expected_levels(position, frame, count)
    assert [len(level) for level in grid.levels] == [len(cells) for cells in levels]
    for level, cells in zip(grid.levels, levels, strict=True):
        rows = {cell: row for row, cell in enumerate(cells)}
        expected = [[rows.get(near, len(cells)) for near in around(cell)] for cell in cells]
        assert level.neighbor.tolist() == expected
    for level, coarse, fine in zip(grid.levels[1:], levels[1:], levels[:-1], strict=True):
        offset = level.offset.tolist()
        assert offset[-1] == len(fine)
        for row, cell in enumerate(coarse):
            held = fine[offset[row] : offset[row + 1]]
            assert {(f, x // 2, y // 2, z // 2) for f, x, y, z in held} == {cell}


def test_particles_are_in_their_cells_and_between_the_corners(device: torch.device) -> None:
    position, frame = random_positions(device)
    grid = SparseGrid.around(position, frame, 3, 2)
    (cells, _), offset = expected_levels(position, frame, 2), grid.levels[0].offset.tolist()
    for row, cell in enumerate(cells):
        for particle in grid.order[offset[row] : offset[row + 1]].tolist():
            floor = [int(coordinate // 1) for coordinate in position[particle].tolist()]
            assert (int(frame[particle]), *floor) == cell
    assert sorted(grid.order.tolist()) == list(range(90))
    # Trilinear interpolation reproduces a linear field, here the cells' own frame and center.
    centers = torch.tensor(cells, dtype=torch.float64, device=device)
    centers[:, 1:] += 0.5
    found = grid.sample(centers)
    assert torch.allclose(found, torch.cat([frame[:, None], position], dim=1), atol=1e-12)


def test_the_interpolation_is_continuous_across_faces_and_centers_of_cells(
    device: torch.device,
) -> None:
    # Other particles keep the set of cells the same.
    axis = torch.arange(0.5, 4.0, 0.5, device=device)
    still = torch.cartesian_prod(axis, axis, axis)
    generator = torch.Generator("cpu").manual_seed(1)
    for face, (y, z) in product((2.0, 1.5), ((1.25, 2.25), (2.0, 1.5))):
        sampled = []
        for x in (face - 1e-5, face + 1e-5, face + 0.5):
            moving = torch.tensor([[x, y, z]], device=device)
            position = torch.cat([moving, still])
            grid = SparseGrid.around(position, position.new_zeros(len(position)).long(), 1, 1)
            if not sampled:
                field = torch.randn(len(grid.levels[0]), 5, generator=generator).to(device)
            sampled.append(grid.sample(field)[0])
        assert torch.allclose(sampled[0], sampled[1], atol=1e-3)
        assert not torch.allclose(sampled[0], sampled[2], atol=1e-1)


def test_keys_around_are_those_of_moved_coordinates(device: torch.device) -> None:
    bits = coordinate_bits(frames=5)
    assert bits == 20
    generator = torch.Generator("cpu").manual_seed(2)
    middle = torch.randint(1, 2**bits - 1, (40, 3), generator=generator)
    # Carries through all bits, and the ends of the range.
    special = torch.tensor([[2**19 - 1, 2**19, 1], [2**20 - 2, 1, 2**18 - 1]])
    coordinate = torch.cat([middle, special]).to(device)
    frame = torch.arange(len(coordinate), device=device) % 5
    found = keys_around(encode(coordinate, frame, bits), (-1, 0, 1), bits)
    for column, (k, j, i) in enumerate(product((-1, 0, 1), repeat=3)):
        step = torch.tensor([i, j, k], device=device)
        assert torch.equal(found[:, column], encode(coordinate + step, frame, bits))
    assert len(found.unique()) == found.numel()


def test_a_full_box_is_convolved_as_a_dense_one(device: torch.device) -> None:
    torch.manual_seed(0)
    # More cells than are gathered at once.
    axis = torch.arange(1.0, 12.0, device=device)
    position = torch.cartesian_prod(axis, axis, axis)
    frame = torch.zeros(len(position), dtype=torch.int64, device=device)
    grid = SparseGrid.around(position, frame, 1, 1)
    size = 12
    assert len(grid.levels[0]) == size**3
    cells = torch.tensor(
        morton_order({(0, x, y, z) for x, y, z in product(range(size), repeat=3)}),
        device=device,
    )
    _, x, y, z = cells.unbind(dim=1)
    layer = SparseConvolution(5, 3).to(device).double()
    rows = torch.randn(len(cells), 5, device=device, dtype=torch.float64, requires_grad=True)
    dense = rows.new_zeros(1, 5, size, size, size).index_put(
        (torch.zeros_like(x), torch.arange(5, device=device)[:, None], x, y, z), rows.T
    )
    kernel = layer.weight.view(3, 3, 3, 5, 3).permute(4, 3, 2, 1, 0)
    expected = nn.functional.conv3d(dense, kernel, layer.bias, padding=1)[0, :, x, y, z].T
    found = layer(rows, grid.levels[0].neighbor)
    assert torch.allclose(found, expected, atol=1e-12)
    inputs, weights = [rows, layer.weight, layer.bias], torch.randn_like(found)
    for one, two in zip(
        torch.autograd.grad((found * weights).sum(), inputs),
        torch.autograd.grad((expected * weights).sum(), inputs),
        strict=True,
    ):
        assert torch.allclose(one, two, atol=1e-10)
