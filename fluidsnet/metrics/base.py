"""Base classes of the metrics, and the means that they share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from fluidsnet.particles import Particles
from fluidsnet.periodic import is_periodic


class FrameMean(Metric, ABC):
    """Mean over a frame's fluid particles, then a simulation's frames, then simulations.

    A value that is not finite makes the mean infinite. A subclass defines `update`, which passes
    one value per particle to `add`.
    """

    full_state_update = False

    means: list[Tensor]
    simulations: list[Tensor]

    def __init__(self) -> None:
        super().__init__()
        self.add_state("means", [], dist_reduce_fx="cat")
        self.add_state("simulations", [], dist_reduce_fx="cat")

    def add(self, values: Tensor, particles: Particles, simulation: Tensor) -> None:
        """Add a batch.

        Args:
            values: (N,), one for each fluid particle.
            particles: State with the frame of each particle.
            simulation: (F,) int64, number of the simulation of each frame.
        """
        self.means.append(frame_means(values, particles))
        self.simulations.append(simulation)

    def compute(self) -> Tensor:
        """Return the mean over the frames added so far, ()."""
        return simulation_mean(dim_zero_cat(self.means), dim_zero_cat(self.simulations)).float()


class RolloutMetric(Metric, ABC):
    """Metric of each step of R rollouts: the mean over a simulation's rollouts, then simulations.

    A value that is not finite makes the mean of its step infinite. Steps without a true state are
    left out, and scenes with periodic axes where the metric has no meaning there. Nothing is copied
    to the host before `compute`. Under DDP each process updates its rollouts, and all processes
    know R.

    Args:
        simulations: Number of the simulation of each rollout.
        steps: S, number of steps of the longest rollout.

    Attributes:
        names: Names of the O results, with the unit where there is one.
        components: Length of the tensor that `measure` returns.
        costly: True where measuring takes at least as long as a step of a network.
        of_truth: True where the truth has a value of the metric too.
        knows_periodic: True where it has a meaning in scenes with periodic axes.
    """

    names: ClassVar[tuple[str, ...]]
    components: ClassVar[int] = 1
    costly: ClassVar[bool] = False
    of_truth: ClassVar[bool] = False
    knows_periodic: ClassVar[bool] = False

    full_state_update = False

    values: Tensor
    known: Tensor

    def __init__(self, simulations: Sequence[int], steps: int) -> None:
        super().__init__()
        self.simulations = tuple(simulations)
        shape = (len(self.simulations), steps)
        # Sums over processes, and not lists: a process may have no rollout.
        zeros = torch.zeros(*shape, self.components, dtype=torch.float64)
        self.add_state("values", zeros, dist_reduce_fx="sum")
        self.add_state("known", torch.zeros(shape, dtype=torch.int64), dist_reduce_fx="sum")

    def update(
        self, rollout: int, step: int, predicted: Particles, true: Particles, start: Particles
    ) -> None:
        """Add a state; steps may come in any order.

        Args:
            rollout: Index of the rollout, below R.
            step: Number of the step, counted from 1.
            predicted: Predicted state, one frame on the metric's device.
            true: True state after the same step.
            start: State that the rollout started from.

        Raises:
            ValueError: there is more than one frame.
        """
        if predicted.frames != 1:
            raise ValueError(f"a state of a rollout is one frame, not {predicted.frames}")
        if is_periodic(true.scene) and not self.knows_periodic:
            return
        measured = self.measure(predicted, true, start).double()
        self.values[rollout, step - 1] = measured.nan_to_num(torch.inf, torch.inf, torch.inf)
        self.known[rollout, step - 1] = 1

    @abstractmethod
    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        """Return what is measured of a state, (components,)."""

    def finish(self, values: Tensor) -> Tensor:
        """Return the results (R, S, O) for the measured values (R, S, components)."""
        return values

    def compute(self) -> dict[str, Tensor]:
        """Return the means after 1, 2, … S steps by name, (S,) float64; NaN if not measured."""
        known = self.known.bool()[..., None]
        finished = self.finish(self.values).nan_to_num(torch.inf, torch.inf, torch.inf)
        sums = _sum_by(self.simulations, finished.where(known, 0.0))
        counts = _sum_by(self.simulations, known.long())
        means = (sums / counts.clamp_min(1)).sum(dim=0) / (counts > 0).sum(dim=0)
        return dict(zip(self.names, means.unbind(dim=1), strict=True))

    def measured_simulations(self) -> Tensor:
        """Return the number of simulations measured after 1, 2, … S steps, (S,) int64."""
        return (_sum_by(self.simulations, self.known) > 0).sum(dim=0)


def _sum_by(simulations: tuple[int, ...], values: Tensor) -> Tensor:
    """Sum (R, ...) over the rollouts of each simulation."""
    numbers = sorted(set(simulations))
    index = torch.tensor([numbers.index(number) for number in simulations], device=values.device)
    return values.new_zeros(len(numbers), *values.shape[1:]).index_add_(0, index, values)


def frame_means(values: Tensor, particles: Particles) -> Tensor:
    """Return the mean over the particles of each frame, (F,) float64; inf where not finite.

    Args:
        values: (N,), one for each fluid particle.
        particles: State with the frame of each particle.
    """
    finite = torch.nan_to_num(values.double(), nan=torch.inf, posinf=torch.inf, neginf=torch.inf)
    sums = finite.new_zeros(particles.frames).index_add_(0, particles.frame, finite)
    counts = torch.bincount(particles.frame, minlength=particles.frames)
    return sums / counts


def simulation_mean(values: Tensor, simulation: Tensor) -> Tensor:
    """Return the mean over each simulation's frames, then over simulations.

    Args:
        values: (F, ...), one for each frame.
        simulation: (F,) int64, number of the simulation of each frame.
    """
    numbers, index = torch.unique(simulation, return_inverse=True)
    sums = values.new_zeros(len(numbers), *values.shape[1:]).index_add_(0, index, values)
    counts = index.bincount(minlength=len(numbers))
    mean: Tensor = (sums / counts.view(-1, *[1] * (values.dim() - 1))).mean(dim=0)
    return mean
