"""All rollout metrics, for the models and the baselines."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import final

import torch
from torch import Tensor

from fluidsnet.baselines import Baselines
from fluidsnet.metrics.base import RolloutMetric
from fluidsnet.metrics.density import Density, DensityError
from fluidsnet.metrics.point_clouds import Chamfer, Sinkhorn
from fluidsnet.metrics.positions import (
    CenterOfMass,
    Escaped,
    MSEn,
    NonFinite,
    RolloutPositionError,
)
from fluidsnet.metrics.velocities import KineticEnergy, RolloutVelocityMSE
from fluidsnet.particles import Particles, RolloutStarts

#: Baselines by name. The truth is one for the metrics that have a value of it.
BASELINES = (*Baselines.names, "truth")

MetricKind = Callable[..., RolloutMetric]
#: Metrics that need no pairs of particles of prediction and truth.
FIELD_METRICS: tuple[MetricKind, ...] = (Chamfer, KineticEnergy, DensityError, Escaped, NonFinite)
#: All metrics of a rollout.
METRICS: tuple[MetricKind, ...] = (
    *(RolloutPositionError, MSEn, RolloutVelocityMSE, Chamfer, Sinkhorn, KineticEnergy),
    *(CenterOfMass, DensityError, Escaped, NonFinite),
)

#: Metric values by predictor and name of the metric: (S,) means after 1, 2, … S steps, but for
#: `non_finite_step` (R,), see `NonFinite`.
RolloutResults = dict[str, dict[str, Tensor]]


@final
class RolloutSuite:
    """All metrics of R rollouts.

    Args:
        simulations: Number of the simulation of each rollout.
        steps: S, number of steps of the longest rollout.
        costly_steps: Steps after which the costly metrics are measured, counted from 1.
        device: Device of the states.
        models: Names of the models that are rolled out.
        kinds: Metrics to measure; by default `METRICS`.
    """

    def __init__(
        self,
        simulations: Sequence[int],
        steps: int,
        costly_steps: Collection[int],
        device: torch.device,
        models: Sequence[str] = ("model",),
        kinds: Sequence[MetricKind] | None = None,
    ) -> None:
        self.costly_steps = frozenset(costly_steps)
        self.metrics: dict[str, list[RolloutMetric]] = {}
        density = Density()
        chosen = [
            partial(kind, density=density) if kind is DensityError else kind
            for kind in kinds or METRICS
        ]
        for predictor in (*models, *BASELINES):
            metrics = [kind(simulations, steps).to(device) for kind in chosen]
            self.metrics[predictor] = [
                metric for metric in metrics if metric.of_truth or predictor != "truth"
            ]

    def update(
        self,
        rollout: int,
        step: int,
        states: Mapping[str, Particles],
        true: Particles,
        start: Particles,
    ) -> None:
        """Measure the states after a step.

        Args:
            rollout: Index of the rollout, below R.
            step: Number of the step, counted from 1.
            states: State of each predictor to measure.
            true: True state after the step.
            start: State that the rollout started from.
        """
        for predictor, state in states.items():
            for metric in self.metrics[predictor]:
                if step in self.costly_steps or not metric.costly:
                    metric.update(rollout, step, state, true, start)

    def compute(self) -> RolloutResults:
        """Return the means over the rollouts of all processes, on the CPU."""
        with warnings.catch_warnings():
            # A process may have had no rollout to measure.
            warnings.filterwarnings("ignore", ".*was called before the ``update`` method.*")
            return {
                predictor: {
                    # torchmetrics turns a tensor of one value into a scalar.
                    name: values.reshape(-1).cpu()
                    for metric in metrics
                    for name, values in metric.compute().items()
                }
                for predictor, metrics in self.metrics.items()
            }

    def forget(self, predictor: str) -> None:
        """Reset the metrics of one predictor."""
        for metric in self.metrics[predictor]:
            metric.reset()


def rollout_suite(
    starts: RolloutStarts,
    costly_steps: Collection[int],
    device: torch.device,
    models: Sequence[str] = ("model",),
) -> RolloutSuite | None:
    """Return a suite for the steps that have a true state; None if there are none.

    Args:
        starts: Starts of the rollouts.
        costly_steps: As for `RolloutSuite`; the last step is added.
        device: Device of the states.
        models: Names of the models that are rolled out.
    """
    longest = max(starts.known_steps)
    if longest == 0:
        return None
    simulations = [starts.names.index(name) for name in starts.names]
    return RolloutSuite(simulations, longest, {*costly_steps, longest}, device, models)
