"""Rollouts measured in validation and test."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Literal

import torch
from lightning import Callback, LightningModule, Trainer
from tqdm import tqdm

from fluidsnet.baselines import Baselines
from fluidsnet.errors import UserError
from fluidsnet.metrics.rollout_suite import Figures, RolloutSuite
from fluidsnet.module import FluidsNet
from fluidsnet.particles import RolloutStarts
from fluidsnet.reporting.charts import Charts, ChartSource
from fluidsnet.reporting.rollout_curves import draw_curves
from fluidsnet.reporting.rollout_metrics_table import write_rollout_metrics
from fluidsnet.reporting.rollout_scalars import log_beside, log_scalars, logged_steps, scalars_of
from fluidsnet.reporting.run_folder import run_folder
from fluidsnet.rollout import rollout

#: Those whose position error is drawn with the predictors' in one chart.
CHARTED = (1, 10, 25)


class RolloutMetrics(Callback, ChartSource):
    """Rolls the network out on held-out simulations and logs every metric of the rollouts.

    In validation `rollout/<metric>/<steps>`, which a ModelCheckpoint can monitor where every
    validation rolls out, and the trivial predictors and the integrator's floor as
    `rollout_predictors/<metric>/<steps>/<predictor>`, in a group of their own, as they are many;
    these are measured once, as they do not change. It comes before callbacks that swap weights
    for validation, or it measures the others.

    Models that an `Ablation` trains side by side are rolled out from the same starts, and the
    figures of each are `ablation_rollout/<metric>/<steps>/<name>` as well.

    In `test` the same under `test_rollout/`, `test_rollout_predictors/` and
    `ablation_test_rollout/`; `rollout_metrics.md` and `.csv` in the run's folder, a row a
    predictor and number of steps; and `rollout_metrics.png`, the errors and energies against
    time, also in TensorBoard.

    A rollout goes as far as it is asked to or as its truth goes, whichever is less; after some
    steps fewer simulations may be left, and the table says how many. One that turns
    non-finite counts as infinite from there on, and the table names it and the step.

    Several measure apart, such as from rest and in motion, if each but one has a name: the groups
    are then `rollout_<name>`, `test_rollout_<name>` and so on, the files `rollout_metrics_<name>`.

    Example::

        callbacks:
          - class_path: callbacks.RolloutMetrics
            init_args:
              steps: 100
              starts: [0, 0.5] # the first frame, and half way through
              simulations: 2
              every_n_validations: 10

    Args:
        steps: of each rollout; to the truth's end by default.
        starts: frames that rollouts start at: whole numbers are frames, fractions shares of a
            simulation from 0.0 to below 1.
        simulations: how many are rolled out, from the file's first on; all by default.
        every_n_validations: in training, how often one rolls out; 0 for none in any.
        costly_steps: after which chamfer, sinkhorn and density are taken, and after the last
            step too. At these of 100 steps all metrics cost less than the rollout itself.
        name: where there are several: lower-case letters, digits and ``_``; "" for none.

    Raises:
        UserError: an argument cannot be used.
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
        for argument, value, least in (
            ("steps", 1 if steps is None else steps, 1),
            ("simulations", 1 if simulations is None else simulations, 1),
            ("every_n_validations", every_n_validations, 0),
        ):
            if value < least:
                raise UserError(
                    f"RolloutMetrics: {argument} is {value}; it must be at least {least}."
                )
        if not starts or not all(s >= 0 if isinstance(s, int) else 0 <= s < 1 for s in starts):
            raise UserError(
                f"RolloutMetrics: starts is {list(starts)}; whole numbers are frames, fractions "
                "are shares of a simulation, from 0.0 to below 1, and there must be one."
            )
        if any(step < 1 for step in costly_steps):
            raise UserError(
                f"RolloutMetrics: costly_steps is {list(costly_steps)}; the first step is 1."
            )
        if not re.fullmatch("([a-z][a-z0-9_]*)?", name) or name.endswith("predictors"):
            raise UserError(
                f"RolloutMetrics: the name {name!r} is taken or has other signs than lower-case "
                "letters, digits and _; choose another."
            )
        self.name = name
        self.steps, self.starts, self.simulations = steps, starts, simulations
        self.every_n_validations, self.costly_steps = every_n_validations, costly_steps
        self._validations = 0
        self._suite: RolloutSuite | None = None

    @property
    def state_key(self) -> str:
        """Of several, each has its own state in a checkpoint."""
        return self._named(type(self).__qualname__)

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Checks who is rolled out, and forgets what an earlier run measured.

        Raises:
            UserError: the module is not a FluidsNet, or the data give no rollouts.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("RolloutMetrics measures rollouts of FluidsNet alone.")
        data = getattr(trainer, "datamodule", None)
        if stage != "predict" and not hasattr(data, "rollout_starts"):
            raise UserError(
                "RolloutMetrics needs a data module with rollout_starts, such as SPHDataModule."
            )
        self._validations, self._suite = 0, None
        # Asked for by all processes, since they agree on it.
        self._folder = run_folder(trainer)

    def charts(self, module: FluidsNet) -> Charts:
        """The position errors after some of the steps, the models' and the predictors'."""
        if not self.every_n_validations:
            return {}
        steps = [step for step in CHARTED if self.steps is None or step <= self.steps]
        rollout = self._named("rollout")
        alone = len(module.named_models()) == 1
        group = (
            f"{rollout}(_predictors)?" if alone else f"({rollout}_predictors|ablation_{rollout})"
        )
        tag = f"{group}/position_error_mm/{{}}(/|$)"
        return {
            rollout: {
                f"position error after {step} steps, mm": [tag.format(step)] for step in steps
            }
        }

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Tells TensorBoard to draw model and predictors into one chart."""
        assert isinstance(pl_module, FluidsNet)
        self.write_charts(trainer, pl_module)

    def state_dict(self) -> dict[str, Any]:
        """Of a training that is resumed, which validation comes next."""
        return {"validations": self._validations}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on counting."""
        self._validations = state_dict["validations"]

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Rolls out, if it is this validation's turn, and logs."""
        if trainer.sanity_checking or self.every_n_validations == 0:
            return
        self._validations += 1
        if trainer.state.fn == "fit" and self._validations % self.every_n_validations:
            return
        assert isinstance(pl_module, FluidsNet)
        starts, figures = self._measure(trainer, pl_module, "val")
        scalars = scalars_of(figures, max(starts.steps))
        group = self._named("rollout")
        mine = {f"{group}/{name}": value for name, value in scalars["model"].items()}
        # All processes have the same; their mean spares a warning.
        pl_module.log_dict(mine, sync_dist=True, batch_size=1)
        log_beside(trainer, pl_module, group, scalars)

    def on_test_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Rolls out, logs, and writes the table and the figure."""
        assert isinstance(pl_module, FluidsNet)
        starts, figures = self._measure(trainer, pl_module, "test")
        if not trainer.is_global_zero:
            return
        longest = max(starts.steps)
        scalars = scalars_of(figures, longest)
        group = self._named("test_rollout")
        log_scalars(trainer, group, {"": scalars["model"]})
        log_beside(trainer, pl_module, group, scalars)
        time_step: float = starts[0].state.scene.time_step
        path = self._folder / self._named("rollout_metrics")
        text = write_rollout_metrics(path, figures, starts, logged_steps(longest), time_step)
        draw_curves(path.with_suffix(".png"), figures, time_step, trainer.loggers, group)
        print(f"\n{text}\n{path}.md\n{path}.png")

    def _named(self, words: str) -> str:
        return f"{words}_{self.name}" if self.name else words

    @torch.no_grad()
    def _measure(
        self, trainer: Trainer, module: FluidsNet, split: Literal["val", "test"]
    ) -> tuple[RolloutStarts, Figures]:
        data: Any = trainer.datamodule  # type: ignore[attr-defined]
        starts: RolloutStarts = data.rollout_starts(
            split, self.starts, self.steps, self.simulations
        )
        # Of all but the model, in an earlier validation.
        known = self._suite is not None
        if self._suite is None:
            longest = max(starts.steps)
            names = [starts.names.index(name) for name in starts.names]
            costly = {*self.costly_steps, longest}
            models = list(module.named_models())
            self._suite = RolloutSuite(names, longest, costly, module.device, models)
        for name in module.named_models():
            self._suite.forget(name)
        mine = range(trainer.global_rank, len(starts), trainer.world_size)
        bar = tqdm(
            total=sum(starts.steps[index] for index in mine),
            desc="measuring rollouts",
            unit="step",
            leave=False,
            disable=split == "val" or not trainer.is_global_zero,
        )
        for index in mine:
            self._roll_out(trainer, module, self._suite, starts, index, known, bar)
        bar.close()
        return starts, self._suite.compute()

    @staticmethod
    def _roll_out(
        trainer: Trainer,
        module: FluidsNet,
        suite: RolloutSuite,
        starts: RolloutStarts,
        index: int,
        known: bool,
        bar: Any,
    ) -> None:
        """One rollout of each model; where the others' figures are known, of these alone."""
        start = starts[index].to(module.device)
        rollouts = {
            name: rollout(model, start.state, starts.steps[index])
            for name, model in module.named_models().items()
        }
        baselines = Baselines(start.state, module.model.integrator)
        for step in range(1, starts.steps[index] + 1):
            with trainer.precision_plugin.forward_context():
                states = {name: next(rolled) for name, rolled in rollouts.items()}
            true = start.state.moved(*(value.to(module.device) for value in start.truth[step]))
            others = {} if known else {**baselines.after(step, true), "truth": true}
            suite.update(index, step, {**states, **others}, true, start.state)
            bar.update()
