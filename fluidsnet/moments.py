"""Moments of the neighbors' features about a particle, the sums of continuous convolutions."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fluidsnet.kernels import moments as compiled
from fluidsnet.kernels import use_kernel
from fluidsnet.torch_extensions import gather_csr, segment_csr

#: Number of moments of each feature.
MOMENTS = compiled.MOMENTS


def neighbor_moments(
    block: nn.Module,
    position: Tensor,
    features: Tensor,
    neighbor: Tensor,
    offset: Tensor,
    radius: float,
) -> Tensor:
    r"""Return kernel-weighted moments of the neighbors' features, (N, 10·C).

    .. math:: A_{ik} = \sum_{j \in N_i} φ_k(r_{ij}) h_j, \quad
        φ(r) = 0.3 (1 - |r|^2)^3 \{1,\ 2r,\ 4 r r^T\}

    with r the offset to the neighbor in support radii, and the six different products of r rᵀ in
    the order xx, yy, zz, xy, xz, yz. Moment k is in the columns k·C to (k + 1)·C. A linear layer
    of the moments is a continuous convolution whose filters are polynomials of degree two.

    Args:
        block: Block that calls, for the choice of the kernel.
        position: (N, 3) m; gets no gradient.
        features: (N, C) of the same particles.
        neighbor: (E,) int64 row of the neighbor of each edge; for every edge there is the
            opposite one.
        offset: (N + 1,) int64, particle i has the edges offset[i] to offset[i + 1].
        radius: Support radius, m.
    """
    position = position.detach()
    if use_kernel(block, position, differentiable=True) and features.dtype == torch.float32:
        return compiled.moments(position, features, neighbor, offset, radius)
    offsets = (position.index_select(0, neighbor) - gather_csr(position, offset)) / radius
    received = features.index_select(0, neighbor)
    sums = [
        segment_csr(weight[:, None].to(received.dtype) * received, offset, reduce="sum")
        for weight in moment_weights(offsets)
    ]
    return torch.cat(sums, dim=1)


def moment_weights(offset: Tensor) -> list[Tensor]:
    """Return the ten weights (E,) of `neighbor_moments` at offsets (E, 3) in support radii."""
    x, y, z = offset.unbind(dim=1)
    weight = 0.3 * (1 - offset.square().sum(dim=1)).clamp_min(0) ** 3
    first = [2 * weight * it for it in (x, y, z)]
    second = [4 * weight * it for it in (x * x, y * y, z * z, x * y, x * z, y * z)]
    return [weight, *first, *second]
