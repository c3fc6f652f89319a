"""The local feature: what a particle's neighbors do (paper, section 4.3, figure 3)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import torch
from torch import Tensor, nn
from torch.profiler import record_function
from torch_scatter import gather_csr, segment_csr

from fluidsnet.features.dense import as_array, compiled_path_for, padded
from fluidsnet.features.edge_mean import edge_mean
from fluidsnet.features.float32_linear import Float32Linear
from fluidsnet.features.fused import EdgeLayers, neighbor_mean
from fluidsnet.features.input import FLUID, SOLID, InputFeature
from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles


class LocalFeature(nn.Module, ABC):
    """A feature of a particle's neighborhood.

    Attributes:
        width: of the feature.
    """

    width: int

    @abstractmethod
    def forward(self, particles: Particles, neighbors: Neighbors, inputs: InputFeature) -> Tensor:
        """The local feature (N, width) of the fluid particles.

        Args:
            particles: N fluid particles and the solid ones.
            neighbors: of the fluid particles.
            inputs: gives velocities their scale.
        """

    def without_edges(
        self, particles: Particles, search: NeighborSearch, inputs: InputFeature
    ) -> Tensor | None:
        """The same feature where no gradient is needed, without storing neighbors.

        Args:
            particles: N fluid particles and the solid ones.
            search: whose neighbors would be taken.
            inputs: gives velocities their scale.

        Returns:
            (N, width), or None where there is no such way.
        """
        return None


@final
class NeighborMean(LocalFeature):
    r"""The paper's: an average of what two layers make of each neighbor.

    .. math:: f_i = \frac{1}{|N_i|} \sum_{j \in N_i}
        \tanh(W_2 \tanh(W_1 [(x_j - x_i) / h, v_j / \sigma_v, s_j] + b_1) + b_2)

    with support radius h. A particle without neighbors gets zeros.

    Args:
        hidden: width of the first layer (Table 1: 7).
        width: of the feature (Table 1: 9).
    """

    def __init__(self, hidden: int = 7, width: int = 9) -> None:
        super().__init__()
        self.width = width
        self.edge = nn.Sequential(
            Float32Linear(InputFeature.width, hidden),
            nn.Tanh(),
            nn.Linear(hidden, width),
            nn.Tanh(),
        )

    def forward(self, particles: Particles, neighbors: Neighbors, inputs: InputFeature) -> Tensor:
        if not _needs_torch(particles):
            position = torch.cat([particles.position, particles.solid_position])
            rows = torch.cat([position, sent_by(particles, inputs)], dim=1)
            first, second = (layer for layer in self.edge if isinstance(layer, nn.Linear))
            # Offsets are in support radii for the weights, and rounded least in m.
            along = first.weight[:, :3] / particles.scene.support_radius
            weight = torch.cat([along, first.weight[:, 3:]], dim=1)
            layers = (weight, first.bias), (second.weight, second.bias)
            return edge_mean(rows, neighbors, *layers)
        edges = edge_inputs(particles, neighbors, inputs)
        sent = self.edge(edges).to(edges.dtype)
        pooled: Tensor = segment_csr(sent, neighbors.offset, reduce="mean")
        return pooled

    def without_edges(
        self, particles: Particles, search: NeighborSearch, inputs: InputFeature
    ) -> Tensor | None:
        if not compiled_path_for(particles.position):
            return None
        with record_function("sort"):
            cells = search.cells(particles)
        if cells is None:
            return None
        first, second = (layer for layer in self.edge if isinstance(layer, nn.Linear))
        radius = particles.scene.support_radius
        marked = first.weight[:, 6]
        layers = EdgeLayers(
            # Of two particles at one place, which is all a radius of zero allows, no offset.
            offset=as_array(first.weight[:, :3] / radius if radius else 0 * first.weight[:, :3]),
            velocity=as_array(inputs.scaled(first.weight[:, 3:6])),
            fluid=as_array(first.bias + FLUID * marked),
            solid=as_array(first.bias + SOLID * marked),
            weight=padded(second.weight),
            bias=as_array(second.bias),
        )
        with record_function("search + local"):
            return neighbor_mean(particles, cells, layers, search.k)


def edge_inputs(particles: Particles, neighbors: Neighbors, inputs: InputFeature) -> Tensor:
    """[x_j - x_i, v_j, s_j] of each edge, (E, 7): offset in support radii, scaled velocity.

    Args:
        particles: N fluid particles and the solid ones.
        neighbors: E edges.
        inputs: gives velocities their scale.
    """
    sent = sent_by(particles, inputs).index_select(0, neighbors.neighbor)
    return torch.cat([edge_offsets(particles, neighbors), sent], dim=1)


def sent_by(particles: Particles, inputs: InputFeature) -> Tensor:
    """[v_j, s_j] of each fluid and solid particle, (N + M, 4), the velocity scaled."""
    velocity = torch.cat([particles.velocity, particles.solid_velocity])
    marker = velocity.new_full((len(velocity), 1), SOLID)
    marker[: len(particles)] = FLUID
    return torch.cat([inputs.scaled(velocity), marker], dim=1)


def edge_offsets(particles: Particles, neighbors: Neighbors) -> Tensor:
    """x_j - x_i of each edge in support radii, (E, 3).

    Args:
        particles: N fluid particles and the solid ones.
        neighbors: E edges.
    """
    position = torch.cat([particles.position, particles.solid_position])
    # Unlike plain indexing, these two have backward passes that add up rows in order.
    there = position.index_select(0, neighbors.neighbor)
    here: Tensor = gather_csr(particles.position, neighbors.offset)
    return (there - here) / particles.scene.support_radius


def _needs_torch(particles: Particles) -> bool:
    """Whether the compiled path, which is for float32 on the CPU, lacks a gradient or a type."""
    state = (particles.position, particles.velocity)
    return particles.scene.support_radius == 0 or any(
        values.requires_grad or values.device.type != "cpu" or values.dtype != torch.float32
        for values in state
    )
