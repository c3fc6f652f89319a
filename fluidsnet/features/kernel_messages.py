"""A local feature in the spirit of SPH: sums over neighbors, weighted by a kernel.

Beyond the paper: its average of the neighbors cannot tell a dense neighborhood from a thin
one, and a neighbor that crosses the support radius changes it with a jump.
"""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor, nn
from torch_scatter import gather_csr, segment_csr

from fluidsnet.features.float32_linear import Float32Linear
from fluidsnet.features.input import FLUID, SOLID, InputFeature
from fluidsnet.features.local import LocalFeature, edge_offsets
from fluidsnet.neighbors.search import Neighbors
from fluidsnet.particles import Particles


@final
class KernelMessages(LocalFeature):
    r"""Rounds of messages that fade towards the support radius h.

    .. math:: m_i = \sum_{j \in N_i} (1 - q_{ij}^2)^3
        \tanh(A (x_j - x_i) / h + B [v_j / \sigma_v, s_j, f_j] - C v_i / \sigma_v)
    .. math:: f_i \leftarrow \tanh(D [f_i, m_i])

    with q the distance over h, and f zero for solids and before the first round. Velocities
    enter as they are and the particle's own can be subtracted, so that relative ones need
    not be formed for each edge.

    Args:
        width: of the messages and of the feature.
        rounds: of messages; each reaches one support radius further.
    """

    def __init__(self, width: int = 24, rounds: int = 2) -> None:
        super().__init__()
        self.width = width
        self.offset = nn.ModuleList(Float32Linear(3, width, bias=False) for _ in range(rounds))
        # Of a sender: velocity, marker, and from the second round on its feature.
        self.sender = nn.ModuleList(
            nn.Linear(4 + (width if number else 0), width) for number in range(rounds)
        )
        self.receiver = nn.ModuleList(nn.Linear(3, width, bias=False) for _ in range(rounds))
        self.update = nn.ModuleList(
            nn.Linear(width * (2 if number else 1), width) for number in range(rounds)
        )

    def forward(self, particles: Particles, neighbors: Neighbors, inputs: InputFeature) -> Tensor:
        offset = edge_offsets(particles, neighbors)
        weight = (1 - offset.square().sum(dim=1, keepdim=True)).clamp_min(0) ** 3
        own = inputs.scaled(particles.velocity)
        solid = inputs.scaled(particles.solid_velocity)
        marker = own.new_full((len(own) + len(solid), 1), SOLID)
        marker[: len(own)] = FLUID
        states = torch.cat([torch.cat([own, solid]), marker], dim=1)
        feature = own.new_zeros(len(own), 0)
        layers = zip(self.offset, self.sender, self.receiver, self.update, strict=True)
        for along, send, receive, update in layers:
            resting = feature.new_zeros(len(solid), feature.shape[1])
            # Also in mixed precision, sums over edges, and those of gradients, are precise.
            sent = send(torch.cat([states, torch.cat([feature, resting])], dim=1)).to(own.dtype)
            edges = (
                sent.index_select(0, neighbors.neighbor)
                - gather_csr(receive(own).to(own.dtype), neighbors.offset)
                + along(offset)
            )
            message = segment_csr(weight * torch.tanh(edges), neighbors.offset, reduce="sum")
            feature = torch.tanh(update(torch.cat([feature, message], dim=1)))
        return feature.to(own.dtype)
