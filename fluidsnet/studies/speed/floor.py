"""Lower bound on the time of a step (roofline model): memory bandwidth and arithmetic."""

from __future__ import annotations

from itertools import pairwise
from timeit import repeat
from typing import Any

import torch

from fluidsnet.features.global_feature import GlobalVector
from fluidsnet.features.local import NeighborMean
from fluidsnet.network import Network

# Operations of a tanh: a quotient of two polynomials.
_TANH = 16


def measure_cores() -> dict[str, float]:
    """Measure memory bandwidth and arithmetic of torch's threads, best of five tries each.

    Returns:
        `bandwidth`: bytes/s of a copy between arrays larger than the caches, read and write
        counted. `flops`: operations/s of a float32 matrix product, a multiply-add counted as two.
    """
    source, size = torch.ones(2**26), 2048
    target = torch.empty_like(source)
    left, right = torch.randn(2, size, size)
    return {
        "bandwidth": 8 * len(source) / min(repeat(lambda: target.copy_(source), number=1)),
        "flops": 2 * size**3 / min(repeat(lambda: left @ right, number=1)),
    }


def step_floor(network: Network, particles: int, edges: float) -> dict[str, float] | None:
    """Count the bytes and operations that one step needs at least.

    Each number moves once, as if caches were perfect: positions and velocities in and out, and
    the features of a particle twice, since the global vector depends on all of them. Operations
    are those of the layers, with the first layer of the edge network applied to particles in
    place of edges. The neighbor search is not counted. `docs/speed.md` has the derivation.

    Returns:
        `bytes` and `operations` for a number of particles with a mean number of neighbors
        (`edges`); None for a network without the paper's local feature and global vector.
    """
    local, vector, inputs = network.local, network.global_feature, network.inputs.width
    if not (isinstance(local, NeighborMean) and isinstance(vector, GlobalVector)):
        return None
    first, second = (layer for layer in local.edge if isinstance(layer, torch.nn.Linear))
    hidden, width = first.out_features, second.out_features
    # The means over edges and over voxels add each number once.
    per_edge = hidden * (1 + _TANH) + width * (2 * hidden + _TANH + 1)
    layers: Any = vector.voxel.layers
    voxels = [inputs + width, *(layer.linear.out_features for layer in layers)]
    head = [network.head.widths[0] - vector.width, *network.head.widths[1:]]
    per_particle = 2 * first.in_features * hidden
    per_particle += sum(after * (2 * before + _TANH + 1) for before, after in pairwise(voxels))
    per_particle += sum(after * (2 * before + _TANH) for before, after in pairwise(head))
    # The last layer has no tanh.
    per_particle -= _TANH * head[-1]
    return {
        "bytes": particles * (24 + 24 + 2 * 4 * (inputs + width)),
        "operations": particles * (edges * per_edge + per_particle),
    }
