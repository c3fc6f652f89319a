"""The mean over particles, then over frames, that the other metrics are made of."""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric

from fluidsnet.particles import Particles


class FrameMean(Metric):
    """Mean over a frame's fluid particles, then over frames, each frame weighing the same.

    A value that is not finite makes the mean infinite; it is never left out. A metric of one
    value a particle defines `update` and hands the values to `add`.
    """

    full_state_update = False

    total: Tensor
    frames: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("frames", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    def add(self, values: Tensor, particles: Particles) -> None:
        """Adds a batch.

        Args:
            values: (N,), one a fluid particle.
            particles: says which frame each is in.
        """
        self.total += frame_means(values, particles).sum()
        self.frames += particles.frames

    def compute(self) -> Tensor:
        """The mean over the frames so far."""
        return (self.total / self.frames).float()


def frame_means(values: Tensor, particles: Particles) -> Tensor:
    """Mean of one value a particle, (N,), over each frame: (F,), float64, inf where not finite."""
    finite = torch.nan_to_num(values.double(), nan=torch.inf, posinf=torch.inf, neginf=torch.inf)
    sums = finite.new_zeros(particles.frames).index_add_(0, particles.frame, finite)
    counts = torch.bincount(particles.frame, minlength=particles.frames)
    return sums / counts
