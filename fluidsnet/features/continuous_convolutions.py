"""Local feature of continuous convolutions, whose filters are polynomials."""

from __future__ import annotations

from typing import final

from torch import Tensor, nn
from torch.nn.functional import silu

from fluidsnet.features.float32_linear import Float32Linear
from fluidsnet.features.input import InputFeature
from fluidsnet.features.local import LocalFeature
from fluidsnet.features.prior_state import PriorState
from fluidsnet.moments import MOMENTS, neighbor_moments
from fluidsnet.neighbors.search import Neighbors
from fluidsnet.particles import Particles


@final
class ContinuousConvolutions(LocalFeature):
    r"""Residual rounds of continuous convolutions over the fluid neighbors of the prior.

    .. math:: h \leftarrow h + O\, \mathrm{silu}(W h + V A(P h))

    with the ten kernel-weighted moments A of `neighbor_moments`, at the prior's positions. The
    first h is silu of a linear layer of the input feature, which describes the walls.

    Args:
        width: Width of h, and of the feature.
        channels: Width of P h, whose moments are summed.
        rounds: Number of rounds; each reaches one support radius further.
        input_width: Number of columns of the input feature.
    """

    at_guess = True

    def __init__(
        self,
        width: int = 32,
        channels: int = 16,
        rounds: int = 2,
        input_width: int = PriorState.width,
    ) -> None:
        super().__init__()
        self.width, self.input_width = width, input_width
        self.enter = Float32Linear(input_width, width)
        self.narrow = nn.ModuleList(nn.Linear(width, channels) for _ in range(rounds))
        self.own = nn.ModuleList(nn.Linear(width, width) for _ in range(rounds))
        self.around = nn.ModuleList(
            nn.Linear(MOMENTS * channels, width, bias=False) for _ in range(rounds)
        )
        self.out = nn.ModuleList(nn.Linear(width, width) for _ in range(rounds))

    def forward(
        self, particles: Particles, neighbors: Neighbors, inputs: InputFeature, columns: Tensor
    ) -> Tensor:
        feature = silu(self.enter(columns))
        rounds = zip(self.narrow, self.own, self.around, self.out, strict=True)
        for narrow, own, around, out in rounds:
            moments = neighbor_moments(
                self,
                particles.position,
                narrow(feature),
                neighbors.neighbor,
                neighbors.offset,
                particles.scene.support_radius,
            )
            feature = feature + out(silu(own(feature) + around(moments)))
        return feature.to(columns.dtype)
