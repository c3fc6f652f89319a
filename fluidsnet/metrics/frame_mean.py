"""The mean over particles, then frames, then simulations, that the other metrics are made of."""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from fluidsnet.particles import Particles


class FrameMean(Metric):
    """Mean over a frame's fluid particles, then a simulation's frames, then simulations.

    A value that is not finite makes the mean infinite; it is never left out. A metric of one
    value a particle defines `update` and hands the values to `add`.
    """

    full_state_update = False

    means: list[Tensor]
    simulations: list[Tensor]

    def __init__(self) -> None:
        super().__init__()
        self.add_state("means", [], dist_reduce_fx="cat")
        self.add_state("simulations", [], dist_reduce_fx="cat")

    def add(self, values: Tensor, particles: Particles, simulation: Tensor) -> None:
        """Adds a batch.

        Args:
            values: (N,), one a fluid particle.
            particles: says which frame each is in.
            simulation: (F,) int64, which one each frame is of.
        """
        self.means.append(frame_means(values, particles))
        self.simulations.append(simulation)

    def compute(self) -> Tensor:
        """The mean over the frames so far."""
        return simulation_mean(dim_zero_cat(self.means), dim_zero_cat(self.simulations)).float()


def frame_means(values: Tensor, particles: Particles) -> Tensor:
    """Mean of one value a particle, (N,), over each frame: (F,), float64, inf where not finite."""
    finite = torch.nan_to_num(values.double(), nan=torch.inf, posinf=torch.inf, neginf=torch.inf)
    sums = finite.new_zeros(particles.frames).index_add_(0, particles.frame, finite)
    counts = torch.bincount(particles.frame, minlength=particles.frames)
    return sums / counts


def simulation_mean(values: Tensor, simulation: Tensor) -> Tensor:
    """Mean over each simulation's frames, then over simulations.

    Args:
        values: (F, ...), one a frame.
        simulation: (F,) int64, which one each frame is of.
    """
    names, index = torch.unique(simulation, return_inverse=True)
    sums = values.new_zeros(len(names), *values.shape[1:]).index_add_(0, index, values)
    counts = index.bincount(minlength=len(names))
    mean: Tensor = (sums / counts.view(-1, *[1] * (values.dim() - 1))).mean(dim=0)
    return mean
