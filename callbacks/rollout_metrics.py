"""Metrics of rollouts in validation, test and prediction."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from lightning import Callback, LightningModule, Trainer

from fluidsnet.errors import UserError
from fluidsnet.metrics.suite import BASELINES, RolloutResults, RolloutSuite, rollout_suite
from fluidsnet.module import FluidsNet
from fluidsnet.particles import Particles, RolloutStart, RolloutStarts
from fluidsnet.progress import Progress
from fluidsnet.reporting.charts import Charts, ChartSource
from fluidsnet.reporting.requirements import is_first, require_fluidsnet, require_rollout_starts
from fluidsnet.reporting.results import results_folder
from fluidsnet.reporting.rollout_curves import draw_curves
from fluidsnet.reporting.rollout_frames import roll_out
from fluidsnet.reporting.rollout_metrics_table import write_rollout_metrics
from fluidsnet.reporting.rollout_scalars import log_predictors, log_scalars, rollout_scalars
from fluidsnet.rollout import RolloutObserver

#: Numbers of steps whose position error has a chart.
CHARTED = (1, 10, 25)


class RolloutMetrics(Callback, ChartSource, RolloutObserver):
    """Measure rollouts on held-out simulations with all metrics.

    In validation it logs `rollout/<metric>/<steps>`, which a ModelCheckpoint can monitor if every
    validation rolls out, and the baselines, measured once, as
    `rollout_predictors/<metric>/<steps>/<predictor>`. Twins of an `Ablation` are rolled out from
    the same starts and logged with the model as `ablation_rollout/<metric>/<steps>/<name>`. It
    must come before callbacks that swap weights for validation, to measure the swapped weights.

    In `test` the groups are `test_rollout/`, `test_rollout_predictors/` and
    `ablation_test_rollout/`. The table `rollout_metrics.md` and `.csv` has a row for each
    predictor and number of steps, with the number of simulations that are that long; a rollout
    that becomes non-finite counts as infinite from there on, and is named. `rollout_metrics.png`,
    also in TensorBoard, has errors and energies against time.

    In `predict` the first callback of this class measures the rollouts of `predict` up to the
    truth's end, and writes the table `rollout_metrics_predict`; without a truth there is none.

    Several callbacks, such as from rest and in motion, need different names: the groups are then
    `rollout_<name>`, `test_rollout_<name>` and so on, the files `rollout_metrics_<name>`.

    Example:
        .. code-block:: yaml

            callbacks:
              - class_path: callbacks.RolloutMetrics
                init_args:
                  steps: 100
                  starts: [0, 0.5] # the first frame, and half way through
                  simulations: 2
                  every_n_validations: 10

    Args:
        steps: Number of steps of each rollout; by default up to the truth's end.
        starts: Frames that rollouts start at: a whole number is a frame, a fraction is a share of
            the simulation, from 0.0 to below 1.
        simulations: Number of simulations, from the first in the file; all by default.
        every_n_validations: Number of validations in training from one that rolls out to the
            next; 0 for none.
        costly_steps: Steps after which chamfer, Sinkhorn and density are measured, besides the
            last. At these of 100 steps all metrics cost less than the rollout.
        name: Name of this callback among several: lower-case letters, digits and ``_``.

    Raises:
        UserError: an argument is out of range.
    """

    def __init__(
        self,
        steps: int | None = 100,
        starts: Sequence[int | float] = (0,),
        simulations: int | None = 2,
        every_n_validations: int = 10,
        costly_steps: Sequence[int] = (25, 50, 100),
        name: str = "",
    ) -> None:
        positive, not_negative = "it must be at least 1", "it must be at least 0"
        frames = "give at least one: whole numbers are frames, fractions below 1 are shares"
        letters = "it is taken or has characters other than lower-case letters, digits and _"
        free = name != "predict" and not name.endswith("predictors")
        for argument, value, valid, rule in (
            ("steps", steps, steps is None or steps > 0, positive),
            ("simulations", simulations, simulations is None or simulations > 0, positive),
            ("every_n_validations", every_n_validations, every_n_validations >= 0, not_negative),
            ("starts", list(starts), starts and all(map(_is_start, starts)), frames),
            ("costly_steps", list(costly_steps), all(n > 0 for n in costly_steps), positive),
            ("name", repr(name), free and re.fullmatch("([a-z][a-z0-9_]*)?", name), letters),
        ):
            if not valid:
                raise UserError(f"RolloutMetrics: {argument} is {value}; {rule}.")
        self.name = name
        self.steps, self.starts, self.simulations = steps, starts, simulations
        self.every_n_validations, self.costly_steps = every_n_validations, costly_steps
        self._validations = 0
        self._suite: RolloutSuite | None = None

    @property
    def state_key(self) -> str:
        """Key of this callback's state in a checkpoint."""
        return self._named(type(self).__qualname__)

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Check the module and the data, and look up the folder, all processes together."""
        require_fluidsnet(self, pl_module)
        self._data = require_rollout_starts(self, trainer)
        self._validations, self._suite = 0, None
        if stage in ("test", "predict"):
            self._folder = results_folder(trainer)

    def charts(self, module: FluidsNet) -> Charts:
        """Return TensorBoard charts of the position errors of models and baselines."""
        if not self.every_n_validations:
            return {}
        steps = [step for step in CHARTED if self.steps is None or step <= self.steps]
        group = self._named("rollout")
        single = len(module.named_models()) == 1
        groups = f"{group}(_predictors)?" if single else f"({group}_predictors|ablation_{group})"
        tag = f"{groups}/position_error_mm/{{}}(/|$)"
        return {group: {f"position error after {n} steps, mm": [tag.format(n)] for n in steps}}

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the charts."""
        self.write_charts(trainer, require_fluidsnet(self, pl_module))

    def state_dict(self) -> dict[str, Any]:
        """Return the number of validations so far."""
        return {"validations": self._validations}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the number of validations so far."""
        self._validations = state_dict["validations"]

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Roll out in every n-th validation, and log."""
        if trainer.sanity_checking or self.every_n_validations == 0:
            return
        self._validations += 1
        if trainer.state.fn == "fit" and self._validations % self.every_n_validations:
            return
        module = require_fluidsnet(self, pl_module)
        scalars = rollout_scalars(self._measure(trainer, module, "val"))
        group = self._named("rollout")
        tagged = {f"{group}/{name}": value for name, value in scalars["model"].items()}
        # All processes have the same values; Lightning warns without the mean.
        module.log_dict(tagged, sync_dist=True, batch_size=1)
        log_predictors(trainer, module, group, scalars)

    def on_test_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Roll out, log, and write the table and the picture."""
        module = require_fluidsnet(self, pl_module)
        results = self._measure(trainer, module, "test")
        if not trainer.is_global_zero:
            return
        scalars = rollout_scalars(results)
        group = self._named("test_rollout")
        log_scalars(trainer, group, {"": scalars["model"]})
        log_predictors(trainer, module, group, scalars)
        path = self._folder / self._named("rollout_metrics")
        self._write_table(path, results)
        picture = path.with_suffix(".png")
        draw_curves(picture, results, self._data.time_step, trainer.loggers, group)
        print(picture)

    def on_predict_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Start a suite for the rollouts of `predict`."""
        self._suite = None
        if is_first(self, trainer):
            loader: Any = trainer.predict_dataloaders
            self._starts = loader.dataset
            self._suite = rollout_suite(self._starts, self.costly_steps, pl_module.device)

    def on_rollout_step(
        self, start: RolloutStart, step: int, states: Mapping[str, Particles]
    ) -> None:
        """Measure a step of a rollout that has a truth."""
        if "truth" in states and self._suite is not None:
            index = self._starts.names.index(start.name)
            self._suite.update(index, step, states, states["truth"], start.state)

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the table."""
        if not is_first(self, trainer):
            return
        results = self._suite.compute() if self._suite else None
        if not trainer.is_global_zero:
            return
        if results is not None and results["model"]["simulations"].any():
            self._write_table(self._folder / "rollout_metrics_predict", results)
        else:
            print("No state of the rollouts has a truth: there is no table of rollout metrics.")

    def _named(self, prefix: str) -> str:
        return f"{prefix}_{self.name}" if self.name else prefix

    def _write_table(self, path: Path, results: RolloutResults) -> None:
        """Write and print the table."""
        time_step = self._data.time_step
        print(write_rollout_metrics(path, results, self._starts, time_step), f"{path}.md", sep="\n")

    @torch.no_grad()
    def _measure(
        self, trainer: Trainer, module: FluidsNet, split: Literal["val", "test"]
    ) -> RolloutResults:
        """Roll out all models from the starts of a split."""
        starts: RolloutStarts = self._data.rollout_starts(
            split, self.starts, self.steps, self.simulations
        )
        models = list(module.named_models())
        names = models
        if self._suite is None:
            # Baselines do not change and are measured once.
            names = [*models, *BASELINES]
            self._starts = starts
            self._suite = rollout_suite(starts, self.costly_steps, module.device, models)
        assert self._suite is not None
        for name in models:
            self._suite.forget(name)
        indices = range(trainer.global_rank, len(starts), trainer.world_size)
        bar = Progress(
            total=sum(starts.steps[index] for index in indices),
            desc="measuring rollouts",
            unit="step",
            leave=False,
            disable=split == "val" or not trainer.is_global_zero,
        )
        for index in indices:
            start = starts[index].to(module.device)
            for step, states in enumerate(roll_out(trainer, module, start), start=1):
                measured = {name: states[name] for name in names}
                self._suite.update(index, step, measured, states["truth"], start.state)
                bar.update()
        bar.close()
        return self._suite.compute()


def _is_start(frame: int | float) -> bool:
    return frame >= 0 and (isinstance(frame, int) or frame < 1)
