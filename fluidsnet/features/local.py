"""Local feature: the neighborhood of a particle (paper, section 4.3, figure 3)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.features.float32_linear import Float32Linear
from fluidsnet.features.input import InputFeature, ParticleState
from fluidsnet.features.perceptron import linear_layers
from fluidsnet.kernels import use_kernel
from fluidsnet.kernels.edge_mean import edge_mean
from fluidsnet.neighbors.search import Neighbors
from fluidsnet.particles import Particles
from fluidsnet.torch_extensions import gather_csr, segment_csr


class LocalFeature(nn.Module, ABC):
    """Feature of a particle's neighborhood.

    Attributes:
        width: Number of columns of the feature.
        input_width, sent_width, relative_width: Numbers of columns that it expects of the input
            feature, see `InputFeature` (its `width` is `input_width`); None where it takes any.
        at_guess: It takes the particles where the prior puts them, and the prior's neighbors.
    """

    width: int
    input_width: int | None = None
    sent_width: int | None = None
    relative_width: int | None = None
    at_guess: bool = False

    @abstractmethod
    def forward(
        self, particles: Particles, neighbors: Neighbors, inputs: InputFeature, columns: Tensor
    ) -> Tensor:
        """Return the local feature (N, width) of the fluid particles.

        Args:
            particles: N fluid particles and M solid ones.
            neighbors: E edges of the fluid particles.
            inputs: Input feature, which gives what neighbors send.
            columns: (N, A) input feature of the fluid particles.
        """


@final
class NeighborMean(LocalFeature):
    r"""The paper's local feature: mean over the neighbors of a two-layer edge network.

    .. math:: f_i = \frac{1}{|N_i|} \sum_{j \in N_i}
        \tanh(W_2 \tanh(W_1 [(x_j - x_i) / h, v_j / \sigma_v, s_j] + b_1) + b_2)

    with support radius h. A particle without neighbors gets zeros.

    Args:
        hidden: Width of the first layer (Table 1: 7).
        width: Width of the feature (Table 1: 9).
        sent_width: Number of columns that a neighbor sends (v and s: 4).
    """

    def __init__(
        self, hidden: int = 7, width: int = 9, sent_width: int = ParticleState.sent_width
    ) -> None:
        super().__init__()
        self.width, self.sent_width = width, sent_width
        self.edge = nn.Sequential(
            Float32Linear(3 + sent_width, hidden),
            nn.Tanh(),
            nn.Linear(hidden, width),
            nn.Tanh(),
        )

    def forward(
        self, particles: Particles, neighbors: Neighbors, inputs: InputFeature, columns: Tensor
    ) -> Tensor:
        sent, radius = inputs.sent(particles), particles.scene.support_radius
        read = (particles.position, particles.solid_position, sent)
        if radius > 0 and use_kernel(self, *read, differentiable=True):
            layers = linear_layers(self.edge)
            return edge_mean(particles, sent, neighbors.neighbor, neighbors.offset, layers)
        received = sent.index_select(0, neighbors.neighbor)
        edges = torch.cat([edge_offsets(particles, neighbors), received], dim=1)
        pooled: Tensor = segment_csr(
            self.edge(edges).to(edges.dtype), neighbors.offset, reduce="mean"
        )
        return pooled


def edge_offsets(particles: Particles, neighbors: Neighbors) -> Tensor:
    """Return x_j - x_i of each edge in support radii, (E, 3).

    Args:
        particles: N fluid particles and M solid ones.
        neighbors: E edges of the fluid particles.
    """
    position = torch.cat([particles.position, particles.solid_position])
    # Unlike plain indexing, both operations have backward passes that sum rows in order.
    neighbor = position.index_select(0, neighbors.neighbor)
    own: Tensor = gather_csr(particles.position, neighbors.offset)
    return (neighbor - own) / particles.scene.support_radius
