"""What the metrics of a rollout have in common: one number a step, one mean for all rollouts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor
from torchmetrics import Metric

from fluidsnet.particles import Particles


class RolloutMetric(Metric, ABC):
    """Measures states of rollouts; the mean is over a simulation's rollouts, then simulations.

    What is not finite is infinite, and so is every mean it is part of. A step that a rollout's
    truth does not reach is in no mean. Nothing is copied to the host before `compute`.

    Under DDP each process updates its own rollouts; all know how many there are.

    Args:
        simulations: which simulation each of the R rollouts is of; any numbers.
        steps: S of the longest.

    Attributes:
        names: of the O numbers it gives, units included where they have one.
        components: of what `measure` gives.
        costly: whether measuring takes about as long as a step of a network, or longer.
        of_truth: whether the truth itself has a figure to compare with.
    """

    names: ClassVar[tuple[str, ...]]
    components: ClassVar[int] = 1
    costly: ClassVar[bool] = False
    of_truth: ClassVar[bool] = False

    full_state_update = False

    values: Tensor
    known: Tensor

    def __init__(self, simulations: Sequence[int], steps: int) -> None:
        super().__init__()
        self.simulations = tuple(simulations)
        shape = (len(self.simulations), steps)
        # Sums of zeros and of what one process knows: no list, since a process may have none.
        empty = torch.zeros(*shape, self.components, dtype=torch.float64)
        self.add_state("values", empty, dist_reduce_fx="sum")
        self.add_state("known", torch.zeros(shape, dtype=torch.int64), dist_reduce_fx="sum")

    def update(
        self, rollout: int, step: int, predicted: Particles, true: Particles, start: Particles
    ) -> None:
        """Adds a state, on the metric's device.

        Args:
            rollout: which of the R it is of.
            step: counted from 1; in any order.
            predicted: one frame.
            true: the same particles, where they truly are then.
            start: the state that the rollout started from.

        Raises:
            ValueError: there is more than one frame.
        """
        if predicted.frames != 1:
            raise ValueError(f"a state of a rollout is one frame, not {predicted.frames}")
        measured = self.measure(predicted, true, start).double()
        self.values[rollout, step - 1] = measured.nan_to_num(torch.inf, torch.inf, torch.inf)
        self.known[rollout, step - 1] = 1

    @abstractmethod
    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        """The (components,) figures of a state."""

    def finish(self, values: Tensor) -> Tensor:
        """From measured (R, S, components), every step up to the truth's end, to (R, S, O)."""
        return values

    def compute(self) -> dict[str, Tensor]:
        """By name, (S,) means after 1, 2, … S steps, float64, NaN where nothing was measured."""
        known = self.known.bool()[..., None]
        finished = self.finish(self.values).nan_to_num(torch.inf, torch.inf, torch.inf)
        means = _mean(finished.where(known, 0.0), known, self.simulations)
        return dict(zip(self.names, means.unbind(dim=1), strict=True))


def _mean(values: Tensor, known: Tensor, simulations: tuple[int, ...]) -> Tensor:
    """Over a simulation's rollouts, then simulations: (S, O) from (R, S, O) and (R, S, 1)."""
    names = sorted(set(simulations))
    index = torch.tensor([names.index(name) for name in simulations], device=values.device)
    sums = values.new_zeros(len(names), *values.shape[1:]).index_add_(0, index, values)
    counts = known.new_zeros(len(names), *known.shape[1:], dtype=torch.int64)
    counts.index_add_(0, index, known.long())
    there = counts > 0
    mean: Tensor = (sums / counts.clamp_min(1)).sum(dim=0) / there.sum(dim=0)
    return mean
