"""What these cores can do: the floor of any implementation."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import torch

from fluidsnet.features.global_feature import GlobalVector
from fluidsnet.features.local import NeighborMean
from fluidsnet.network import Network

# Of a tanh in plain arithmetic: a product of two polynomials and a division.
_TANH = 16


def measure_cores(threads: int) -> dict[str, float]:
    """Bytes and float32 operations a second, the best of several tries.

    Args:
        threads: of torch.

    Returns:
        `bandwidth`, of a copy between two arrays that fit no cache, both ways counted; and
        `flops`, of a product of matrices, a multiply-add counted as two.
    """
    torch.set_num_threads(threads)
    source = torch.ones(2**26)
    target = torch.empty_like(source)
    size = 2048
    left, right = torch.randn(size, size), torch.randn(size, size)
    return {
        "bandwidth": 8 * len(source) / _best(lambda: target.copy_(source)),
        "flops": 2 * size**3 / _best(lambda: left @ right),
    }


def floor(network: Network, particles: int, edges: float) -> dict[str, float] | None:
    """Bytes that must move and operations that must be done for one step.

    Each number is read or written once as if caches were perfect: positions and velocities in
    and out, and the 16 features of a particle twice, because the global vector is known only
    after all of them. Operations are those of the layers, with the first of the edge network
    applied to particles in place of edges; the search itself is not counted, so this is a
    floor and not an estimate. `docs/speed.md` has the derivation.

    Args:
        network: with the paper's local feature and global vector.
        particles: of the fluid.
        edges: neighbors of a particle, on average.

    Returns:
        `bytes` and `operations`; None for other networks.
    """
    local, context = network.local, network.global_feature
    if not (isinstance(local, NeighborMean) and isinstance(context, GlobalVector)):
        return None
    layers: list[Any] = [layer for layer in local.edge if isinstance(layer, torch.nn.Linear)]
    hidden, width = layers[0].out_features, layers[1].out_features
    an_edge = hidden + _TANH * hidden + 2 * hidden * width + _TANH * width + width
    own = 2 * layers[0].in_features * hidden
    before = network.inputs.width + width
    for layer in context.voxel.layers:
        after = layer.linear.out_features  # type: ignore[union-attr]
        own += after * (2 * before + _TANH + 1)
        before = after
    widths = list(network.head.widths)
    widths[0] -= context.width
    for first, second in pairwise(widths):
        own += second * (2 * first + _TANH)
    # The last layer has no tanh.
    own -= _TANH * widths[-1]
    features = 4 * (network.inputs.width + width)
    return {
        "bytes": particles * (24 + 24 + 2 * features),
        "operations": particles * (edges * an_edge + own),
    }


def _best(work: Callable[[], Any], tries: int = 5) -> float:
    seconds = []
    for _ in range(tries):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return min(seconds)
