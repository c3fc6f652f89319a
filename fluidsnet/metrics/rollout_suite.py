"""Every metric of a rollout, of models and of all they are judged beside."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from typing import final

import torch
from torch import Tensor

from fluidsnet.baselines import Baselines
from fluidsnet.metrics.center_of_mass import CenterOfMass
from fluidsnet.metrics.chamfer import Chamfer
from fluidsnet.metrics.density import Density
from fluidsnet.metrics.density_error import DensityError
from fluidsnet.metrics.escaped import Escaped
from fluidsnet.metrics.kinetic_energy import KineticEnergy
from fluidsnet.metrics.mse_n import MSEn
from fluidsnet.metrics.non_finite import NonFinite
from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.metrics.rollout_position_error import RolloutPositionError
from fluidsnet.metrics.rollout_velocity_mse import RolloutVelocityMSE
from fluidsnet.metrics.sinkhorn import Sinkhorn
from fluidsnet.particles import Particles

#: Beside whom models are measured: the truth only where it has a figure of its own.
BESIDE = (*Baselines.names, "truth")

#: By predictor, by the metric's name, (S,) means after 1, 2, … S steps.
Figures = dict[str, dict[str, Tensor]]


@final
class RolloutSuite:
    """The metrics of R rollouts.

    Args:
        simulations: which simulation each rollout is of.
        steps: S of the longest.
        costly_steps: after which the costly metrics are taken, from 1; the others always are.
        device: of the states.
        models: names of those that are rolled out.
    """

    def __init__(
        self,
        simulations: Sequence[int],
        steps: int,
        costly_steps: Collection[int],
        device: torch.device,
        models: Sequence[str] = ("model",),
    ) -> None:
        self.costly_steps = frozenset(costly_steps)
        density = Density()
        self.metrics: dict[str, list[RolloutMetric]] = {}
        for predictor in (*models, *BESIDE):
            metrics: list[RolloutMetric] = [
                RolloutPositionError(simulations, steps),
                MSEn(simulations, steps),
                RolloutVelocityMSE(simulations, steps),
                Chamfer(simulations, steps),
                Sinkhorn(simulations, steps),
                KineticEnergy(simulations, steps),
                CenterOfMass(simulations, steps),
                DensityError(simulations, steps, density),
                Escaped(simulations, steps),
                NonFinite(simulations, steps),
            ]
            self.metrics[predictor] = [
                metric.to(device) for metric in metrics if metric.of_truth or predictor != "truth"
            ]

    def update(
        self,
        rollout: int,
        step: int,
        states: Mapping[str, Particles],
        true: Particles,
        start: Particles,
    ) -> None:
        """Measures the states after a step.

        Args:
            rollout: which of the R.
            step: counted from 1.
            states: by predictor; who is left out is not measured.
            true: the true state then.
            start: the state that they started from.
        """
        for predictor, state in states.items():
            for metric in self.metrics[predictor]:
                if step in self.costly_steps or not metric.costly:
                    metric.update(rollout, step, state, true, start)

    def compute(self) -> Figures:
        """The means, over all processes, on the CPU."""
        with warnings.catch_warnings():
            # A process may have had no rollout to measure.
            warnings.filterwarnings("ignore", ".*was called before the ``update`` method.*")
            return {
                predictor: {
                    # A single number is a scalar to torchmetrics.
                    name: values.reshape(-1).cpu()
                    for metric in metrics
                    for name, values in metric.compute().items()
                }
                for predictor, metrics in self.metrics.items()
            }

    def forget(self, predictor: str) -> None:
        """Drops what was measured of one of them."""
        for metric in self.metrics[predictor]:
            metric.reset()
