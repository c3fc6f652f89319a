"""Lower bound on the time of a step (roofline model): memory bandwidth and arithmetic."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import torch

from fluidsnet.features.global_feature import GlobalVector
from fluidsnet.features.local import NeighborMean
from fluidsnet.network import Network
from fluidsnet.reporting.table import markdown
from fluidsnet.studies.speed.table import number

# Operations of a tanh: a quotient of two polynomials.
_TANH = 16


@dataclass
class Floor:
    """Lower bounds on the time of a step.

    Attributes:
        cores: Result of `measure_cores`; empty where it failed.
        others: Cores that other processes kept busy meanwhile.
        note: Reason of the failure.
        steps: By number of particles: `bytes` and `operations` of a step, and its time `step`, s.
    """

    cores: dict[str, float] = field(default_factory=dict)
    others: float = 0.0
    note: str = ""
    steps: dict[int, dict[str, float]] = field(default_factory=dict)

    def page(self) -> str:
        """Return the section of the page."""
        if not self.cores:
            return f"Bandwidth and arithmetic of the cores were not measured ({self.note}).\n"
        bandwidth, flops = self.cores["bandwidth"], self.cores["flops"]
        rows = [
            [
                f"{particles:,}",
                f"{step['bytes'] / 1e6:,.0f}",
                number(1000 * step["bytes"] / bandwidth),
                f"{step['operations'] / 1e9:.2f}",
                number(1000 * step["operations"] / flops),
                number(1000 * step["step"]),
            ]
            for particles, step in sorted(self.steps.items())
        ]
        header = ("fluid", "MB", "ms for them", "Gflop", "ms for them", "measured ms")
        return (
            f"A copy moves {bandwidth / 1e9:.1f} GB/s and a matrix product does "
            f"{flops / 1e9:.0f} Gflop/s with these threads. At these rates, the bytes of the state "
            "and the arithmetic of the layers, each counted once and without the search, would "
            f"take\n\n{markdown(header, rows)}"
        )


def measure_cores() -> dict[str, float]:
    """Measure memory bandwidth and arithmetic of torch's threads, best of five tries each.

    Returns:
        `bandwidth`: bytes/s of a copy between arrays larger than the caches, read and write
        counted. `flops`: operations/s of a float32 matrix product, a multiply-add counted as two.
    """
    source = torch.ones(2**26)
    target = torch.empty_like(source)
    size = 2048
    left, right = torch.randn(size, size), torch.randn(size, size)
    return {
        "bandwidth": 8 * len(source) / _best_time(lambda: target.copy_(source)),
        "flops": 2 * size**3 / _best_time(lambda: left @ right),
    }


def step_floor(network: Network, particles: int, edges: float) -> dict[str, float] | None:
    """Count the bytes and operations that one step needs at least.

    Each number moves once, as if caches were perfect: positions and velocities in and out, and
    the features of a particle twice, since the global vector depends on all of them. Operations
    are those of the layers, with the first layer of the edge network applied to particles in
    place of edges. The neighbor search is not counted. `docs/speed.md` has the derivation.

    Args:
        network: Network with the paper's local feature and global vector.
        particles: Number of fluid particles.
        edges: Mean number of neighbors of a particle.

    Returns:
        `bytes` and `operations`; None for other networks.
    """
    local, vector = network.local, network.global_feature
    if not (isinstance(local, NeighborMean) and isinstance(vector, GlobalVector)):
        return None
    layers: list[Any] = [layer for layer in local.edge if isinstance(layer, torch.nn.Linear)]
    hidden, width = layers[0].out_features, layers[1].out_features
    per_edge = hidden + _TANH * hidden + 2 * hidden * width + _TANH * width + width
    per_particle = 2 * layers[0].in_features * hidden
    before = network.inputs.width + width
    for layer in vector.voxel.layers:
        after = layer.linear.out_features  # type: ignore[union-attr]
        per_particle += after * (2 * before + _TANH + 1)
        before = after
    widths = list(network.head.widths)
    widths[0] -= vector.width
    per_particle += sum(second * (2 * first + _TANH) for first, second in pairwise(widths))
    # The last layer has no tanh.
    per_particle -= _TANH * widths[-1]
    features = 4 * (network.inputs.width + width)
    return {
        "bytes": particles * (24 + 24 + 2 * features),
        "operations": particles * (edges * per_edge + per_particle),
    }


def _best_time(work: Callable[[], Any], tries: int = 5) -> float:
    seconds = []
    for _ in range(tries):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return min(seconds)
