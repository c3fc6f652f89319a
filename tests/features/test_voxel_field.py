"""The voxel field against a dense U-Net whose missing cells are zero, and its invariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import pytest
import torch
from torch import Tensor, nn

from fluidsnet.errors import UserError
from fluidsnet.features import VoxelField
from fluidsnet.features.sparse_convolution import SparseConvolution
from fluidsnet.features.sparse_grid import SparseGrid
from fluidsnet.particles import Particles
from fluidsnet.scene import Scene

INPUTS = 6


def state(
    position: Tensor,
    lower: Sequence[float] = (0.0, 0.0, 0.0),
    upper: Sequence[float] = (2.0, 1.0, 1.5),
) -> Particles:
    """One frame with a support radius of 0.25 m and no solids."""
    scene = Scene.single(
        lower, upper, (0.0, -9.81, 0.0), particle_radius=0.0625, support_radius=0.25,
        time_step=0.02, device=position.device, dtype=position.dtype,
    )  # fmt: skip
    return Particles.single(position, torch.zeros_like(position), position[:0], scene)


def random(count: int, seed: int = 0, dtype: torch.dtype = torch.float32) -> Tensor:
    """Positions (count, 3) in an L of fluid, multiples of 2^-10 m so that shifts are exact."""
    generator = torch.Generator("cpu").manual_seed(seed)
    position = torch.rand(count, 3, generator=generator, dtype=dtype)
    position[::2] *= torch.tensor([1.0, 0.3, 1.5], dtype=dtype)
    position[1::2] *= torch.tensor([0.3, 1.0, 1.5], dtype=dtype)
    return (position * 1024).round() / 1024


def make_field(device: torch.device, levels: int = 3, cell_size: float = 1.0) -> VoxelField:
    torch.manual_seed(0)
    field = VoxelField((1, 1, 1), INPUTS, channels=4, levels=levels, cell_size=cell_size)
    return field.to(device)


def features_of(particles: Particles, seed: int = 5) -> Tensor:
    generator = torch.Generator("cpu").manual_seed(seed)
    rows = torch.randn(len(particles), INPUTS, generator=generator, dtype=torch.float64)
    return rows.to(particles.position)


def dense(field: VoxelField, particles: Particles, features: Tensor) -> Tensor:
    """Compute the field of one frame on a full box; cells that do not exist are set to zero."""
    count = len(field.down)
    edge = field.cell_size * particles.scene.support_radius
    place = (particles.position - particles.scene.domain_lower) / edge
    low = (place.detach() - 0.5).floor().long()
    whole = 2**count
    start = low.amin(dim=0) // whole * whole
    shape = (((low.amax(dim=0) + 1 - start) // whole + 1) * whole).tolist()
    exists = features.new_zeros(1, 1, *shape)
    for corner in product(range(2), repeat=3):
        x, y, z = (low + torch.tensor(corner, device=low.device) - start).unbind(dim=1)
        exists[0, 0, x, y, z] = 1
    masks = [exists]
    for _ in range(count):
        masks.append(nn.functional.max_pool3d(masks[-1], 2))
    encoded = torch.tanh(field.encode(features))
    columns = [[[encoded.new_zeros(field.width + 1)] * shape[2] for _ in range(shape[1])]
               for _ in range(shape[0])]  # fmt: skip
    own = place.detach().floor().long() - start
    for x, y, z in set(map(tuple, own.tolist())):
        inside = (own == torch.tensor([x, y, z], device=own.device)).all(dim=1)
        full = edge**3 / (2 * particles.scene.particle_radius) ** 3
        filled = (inside.sum() / full)[None].to(encoded)
        columns[x][y][z] = torch.cat([encoded[inside].mean(dim=0), filled])
    volume = torch.stack([torch.stack([torch.stack(line) for line in plane]) for plane in columns])
    volume = volume.permute(3, 0, 1, 2)[None]

    def convolve(layer: nn.Module, values: Tensor, mask: Tensor) -> Tensor:
        assert isinstance(layer, SparseConvolution)
        _, inputs, outputs = layer.weight.shape
        kernel = layer.weight.view(3, 3, 3, inputs, outputs).permute(4, 3, 2, 1, 0)
        return mask * torch.tanh(nn.functional.conv3d(values, kernel, layer.bias, padding=1))

    fine = [convolve(field.enter, volume, masks[0])]
    for layer, mask in zip(field.down, masks[1:], strict=True):
        fine.append(convolve(layer, nn.functional.avg_pool3d(fine[-1], 2), mask))
    values = fine.pop()
    for layer in field.up:
        spread = nn.functional.interpolate(values, scale_factor=2, mode="nearest")
        mask = masks[len(fine) - 1]
        values = convolve(layer, torch.cat([spread * mask, fine.pop()], dim=1), mask)
    sampled = []
    for row in range(len(particles)):
        fraction = place[row] - 0.5 - low[row]
        total = values.new_zeros(field.width)
        for corner in product(range(2), repeat=3):
            x, y, z = (low[row] - start).tolist()
            weight = values.new_ones(())
            for axis, far in enumerate(corner):
                weight = weight * (fraction[axis] if far else 1 - fraction[axis])
            total = total + weight * values[0, :, x + corner[0], y + corner[1], z + corner[2]]
        sampled.append(total)
    return torch.stack(sampled)


@pytest.mark.parametrize(("levels", "cell_size"), [(1, 1.0), (2, 0.7), (3, 1.0)])
def test_values_and_gradients_are_those_of_a_dense_network(
    levels: int, cell_size: float, device: torch.device
) -> None:
    field = make_field(device, levels, cell_size).double()
    # Some particles are outside the domain.
    position = (random(60, dtype=torch.float64).to(device) - 0.1).requires_grad_()
    particles = state(position)
    features = features_of(particles).requires_grad_()
    found, expected = field(particles, features), dense(field, particles, features)
    assert torch.allclose(found, expected, atol=1e-12)
    inputs = [position, features, *field.parameters()]
    weights = torch.randn_like(found)
    gradients = (
        torch.autograd.grad((values * weights).sum(), inputs) for values in (found, expected)
    )
    for one, two in zip(*gradients, strict=True):
        assert two.abs().sum() > 0
        assert torch.allclose(one, two, atol=1e-11)


def test_gradients_are_the_same_in_each_run(device: torch.device) -> None:
    field, position = make_field(device), random(300).to(device).requires_grad_()
    particles = state(position)
    runs = []
    for _ in range(2):
        loss = field(particles, features_of(particles)).square().sum()
        runs.append(torch.autograd.grad(loss, [position, *field.parameters()]))
    assert all(torch.equal(one, two) for one, two in zip(*runs, strict=True))


def test_a_batch_gives_what_its_frames_give(device: torch.device) -> None:
    field = make_field(device)
    frames = [
        state(random(70).to(device)),
        state(random(0).to(device)),
        state(random(50, seed=1).to(device), (-1.0, -0.5, -0.75), (7.0, 2.0, 4.0)),
    ]
    batch = Particles.collate(frames)
    features = features_of(batch)
    expected = [
        field(frame, rows)
        for frame, rows in zip(frames, features.split(list(map(len, frames))), strict=True)
    ]
    assert torch.allclose(field(batch, features), torch.cat(expected), atol=1e-6)


def test_no_particle_at_all(device: torch.device) -> None:
    field = make_field(device)
    nobody = state(random(0).to(device))
    for particles in (nobody, Particles.collate([nobody, nobody])):
        features = features_of(particles).requires_grad_()
        found = field(particles, features)
        assert found.shape == (0, 4)
        found.sum().backward()
        with torch.no_grad():
            assert field(particles, features).shape == (0, 4)


def test_permuted_particles_permute_the_field(device: torch.device) -> None:
    field, particles = make_field(device), state(random(200).to(device))
    features = features_of(particles)
    order = torch.randperm(200, device=device)
    permuted = state(particles.position[order])
    assert torch.allclose(
        field(permuted, features[order]), field(particles, features)[order], atol=1e-6
    )


def test_a_scene_moved_with_its_domain_gives_the_same(device: torch.device) -> None:
    field, position = make_field(device), random(200).to(device)
    features = features_of(state(position))
    by = torch.tensor([4.125, -2.0, 8.5], device=device)
    moved = state(position + by, (4.125, -2.0, 8.5), (6.125, -1.0, 10.0))
    assert torch.equal(field(moved, features), field(state(position), features))


def test_a_larger_box_gives_the_same_and_takes_the_same_weights(device: torch.device) -> None:
    field, particles = make_field(device), state(random(200).to(device))
    features = features_of(particles)
    other = VoxelField((90, 70, 50), INPUTS, channels=4).to(device)
    other.load_state_dict(field.state_dict())
    larger = state(particles.position, upper=(300.0, 100.0, 200.0))
    assert torch.equal(other(larger, features), field(particles, features))


def test_cells_follow_the_particles_and_not_the_distance(device: torch.device) -> None:
    field, position = make_field(device), random(200).to(device)
    features = features_of(state(position))
    # 10 km, where float32 has steps of 2^-10 m.
    far = state(torch.cat([position, position + 10240.0]))
    found = field(far, torch.cat([features, features]))
    alone = field(state(position), features)
    assert torch.allclose(found, torch.cat([alone, alone]), atol=1e-6)
    frame = far.frame
    grids = [
        SparseGrid.around(place / 0.25, frame[: len(place)], 1, 3)
        for place in (position, far.position)
    ]
    for one, two in zip(*(grid.levels for grid in grids), strict=True):
        assert len(two) == 2 * len(one)


def test_positions_that_are_not_finite_or_very_far_harm_no_others(device: torch.device) -> None:
    field, particles = make_field(device), state(random(200).to(device))
    features = features_of(particles)
    position = particles.position.clone()
    nowhere = torch.tensor(
        [[torch.nan, 0.5, 0.5], [torch.inf, -torch.inf, 0.5], [1e30, 0.0, -1e30], [-1e9, 1e9, 1e9]]
    )
    position[:4] = nowhere.to(device)
    position.requires_grad_()
    found = field(state(position), features)
    assert found.isfinite().all()
    found.sum().backward()
    assert position.grad is not None and position.grad.isfinite().all()
    # Of the four, only the one at NaN is near the others: it counts as at the lower corner.
    counted = torch.cat([position.new_zeros(1, 3), position[4:].detach()])
    counted[0, 1:] = 0.5
    expected = field(state(counted), torch.cat([features[:1], features[4:]]))
    assert torch.allclose(found[4:], expected[1:], atol=1e-6)


def test_settings_out_of_range_are_refused() -> None:
    for levels in (0, 9):
        with pytest.raises(UserError, match=f"VoxelField: levels is {levels}; set 1 to 8"):
            VoxelField((1, 1, 1), INPUTS, levels=levels)
    for size in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UserError, match=r"cell_size is .*; set a positive number"):
            VoxelField((1, 1, 1), INPUTS, cell_size=size)


def test_the_frames_of_a_batch_may_have_other_orders_of_magnitude(device: torch.device) -> None:
    field, near = make_field(device), state(random(60).to(device))
    far = replace(near, position=near.position + 2048.0)
    features = features_of(near)
    found = field(Particles.collate([near, far]), torch.cat([features, features]))
    assert torch.allclose(found[:60], found[60:], atol=1e-6)
