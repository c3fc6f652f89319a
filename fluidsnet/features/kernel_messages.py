"""Local feature in the spirit of SPH: kernel-weighted sums over neighbors.

Beyond the paper, whose mean over neighbors does not depend on their density and jumps where a
neighbor crosses the support radius.
"""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.features.float32_linear import Float32Linear
from fluidsnet.features.input import InputFeature, ParticleState
from fluidsnet.features.local import LocalFeature, edge_offsets
from fluidsnet.neighbors.search import Neighbors
from fluidsnet.particles import Particles
from fluidsnet.torch_extensions import gather_csr, segment_csr


@final
class KernelMessages(LocalFeature):
    r"""Rounds of messages whose weight falls to zero at the support radius h.

    .. math:: m_i = \sum_{j \in N_i} (1 - q_{ij}^2)^3
        \tanh(A (x_j - x_i) / h + B [v_j / \sigma_v, s_j, f_j] - C v_i / \sigma_v)
    .. math:: f_i \leftarrow \tanh(D [f_i, m_i])

    with q the distance over h, and f zero for solids and empty in the first round. A and C are
    applied to particles, so that no relative velocity is computed for an edge.

    Args:
        width: Width of the messages and of the feature.
        rounds: Number of rounds; each reaches one support radius further.
        sent_width: Number of columns that a neighbor sends (v and s: 4).
        relative_width: Number of leading columns that C is applied to (v: 3).
    """

    def __init__(
        self,
        width: int = 24,
        rounds: int = 2,
        sent_width: int = ParticleState.sent_width,
        relative_width: int = ParticleState.relative_width,
    ) -> None:
        super().__init__()
        self.width, self.sent_width, self.relative_width = width, sent_width, relative_width
        self.offset = nn.ModuleList(Float32Linear(3, width, bias=False) for _ in range(rounds))
        # From the second round on a sender adds its feature.
        self.sender = nn.ModuleList(
            nn.Linear(sent_width + (width if index else 0), width) for index in range(rounds)
        )
        self.receiver = nn.ModuleList(
            nn.Linear(relative_width, width, bias=False) for _ in range(rounds)
        )
        self.update = nn.ModuleList(
            nn.Linear(width * (2 if index else 1), width) for index in range(rounds)
        )

    def forward(
        self, particles: Particles, neighbors: Neighbors, inputs: InputFeature, columns: Tensor
    ) -> Tensor:
        offset = edge_offsets(particles, neighbors)
        weight = (1 - offset.square().sum(dim=1, keepdim=True)).clamp_min(0) ** 3
        states = inputs.sent(particles)
        own = states[: len(particles), : self.relative_width]
        feature = own.new_zeros(len(own), 0)
        layers = zip(self.offset, self.sender, self.receiver, self.update, strict=True)
        for along, send, receive, update in layers:
            of_solids = feature.new_zeros(len(states) - len(own), feature.shape[1])
            # Sums over edges, and those of gradients, stay in float32 under mixed precision.
            sent = send(torch.cat([states, torch.cat([feature, of_solids])], dim=1)).to(own.dtype)
            edges = (
                sent.index_select(0, neighbors.neighbor)
                - gather_csr(receive(own).to(own.dtype), neighbors.offset)
                + along(offset)
            )
            message = segment_csr(weight * torch.tanh(edges), neighbors.offset, reduce="sum")
            feature = torch.tanh(update(torch.cat([feature, message], dim=1)))
        return feature.to(own.dtype)
