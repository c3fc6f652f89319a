"""Moments of neighbors' features: kernel against torch, values and gradients."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from fluidsnet.kernels import disabled
from fluidsnet.moments import MOMENTS, neighbor_moments

RADIUS = 0.3


def cloud(count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return positions, and neighbor and offset of all pairs within the radius."""
    position = torch.rand(count, 3, generator=torch.Generator().manual_seed(0))
    near = torch.cdist(position, position) <= RADIUS
    near.fill_diagonal_(False)
    return position, near.nonzero()[:, 1], nn.functional.pad(near.sum(dim=1).cumsum(0), (1, 0))


@pytest.mark.parametrize(("count", "channels"), [(300, 16), (70, 5), (1, 8), (0, 4)])
def test_the_kernel_gives_values_and_gradients_of_torch(count: int, channels: int) -> None:
    position, neighbor, offset = cloud(count)
    features = torch.randn(count, channels, requires_grad=True)
    weight = torch.randn(count, MOMENTS * channels)
    results = []
    for context in (torch.enable_grad, disabled):
        with context():
            found = neighbor_moments(nn.Identity(), position, features, neighbor, offset, RADIUS)
        (gradient,) = torch.autograd.grad((found * weight).sum(), features)
        results.append((found.detach(), gradient))
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-5)


def test_moments_against_a_loop() -> None:
    position, neighbor, offset = cloud(40)
    features = torch.randn(40, 2)
    found = neighbor_moments(nn.Identity(), position, features, neighbor, offset, RADIUS)
    for i in range(40):
        expected = torch.zeros(MOMENTS, 2)
        for j in range(40):
            r = (position[j] - position[i]) / RADIUS
            if i == j or r.norm() > 1:
                continue
            weight = 0.3 * (1 - r @ r) ** 3
            x, y, z = r
            second = torch.stack([x * x, y * y, z * z, x * y, x * z, y * z])
            basis = torch.cat([torch.ones(1), 2 * r, 4 * second])
            expected += weight * basis[:, None] * features[j]
        torch.testing.assert_close(found[i].reshape(MOMENTS, 2), expected, atol=1e-6, rtol=1e-5)


def test_gradients_in_float64() -> None:
    position, neighbor, offset = cloud(20)
    features = torch.randn(20, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda it: neighbor_moments(nn.Identity(), position.double(), it, neighbor, offset, RADIUS),
        features,
    )
