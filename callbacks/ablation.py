"""Ablation: a twin of the model that differs in one block, trained beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.utilities import rank_zero_info
from torch import nn

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.block_types import Block, can_be
from fluidsnet.errors import UserError
from fluidsnet.metrics.suite import BASELINES
from fluidsnet.model import BLOCKS, Model
from fluidsnet.module import FluidsNet
from fluidsnet.particles import Transitions
from fluidsnet.reporting.charts import Charts, ChartSource
from fluidsnet.reporting.requirements import require_fluidsnet
from fluidsnet.same_settings import same_settings
from fluidsnet.training_cost import training_costs

#: Figures with a chart; the loss alone is in units that may differ between the models.
_CHARTS = ("train_loss", "velocity_mse", "skill", "position_error_1_mm")


class Ablation(Callback, ChartSource):
    """Train a twin of the model that differs in one block beside it.

    Both start from the same weights where these correspond, get the same batches with the same
    noise, and have their gradients clipped apart. The model trains bit for bit as it would
    alone. Every validation logs `velocity_mse`, `skill` and `position_error_1_mm` of both, as
    ``ablation/<figure>/model`` and ``ablation/<figure>/<name>``, which TensorBoard shows in one
    chart (tab "Custom Scalars"). Every training step logs their losses, each in the units of its
    target. The cost of a training step of each is measured once, on the first batch
    (``ablation/cost/…``). `OneStepTable` has a row for the twin.

    The twin is saved with the model. ``test`` and ``predict`` without this callback leave it out.

    Example:
        .. code-block:: yaml

            callbacks+:
              class_path: callbacks.Ablation
              init_args:
                block: target
                variant: {class_path: fluidsnet.target.AccelerationTarget}
                name: acceleration

    Args:
        block: Name of the block that differs, an argument of `fluidsnet.model.Model`: neighbors,
            inputs, local, global_feature, target, integrator, walls, head or noise.
        variant: The twin's block; None for no noise.
        name: Name of the twin in logs and tables: lower-case letters, digits and ``_``.

    Raises:
        UserError: There is no such block, the variant is of another kind, or the name is taken.
    """

    def __init__(self, block: str, variant: Block = None, name: str = "twin") -> None:
        if block not in BLOCKS:
            raise UserError(
                f"Ablation: there is no block {block!r}; "
                f"the blocks are {', '.join(sorted(BLOCKS))}."
            )
        if not can_be(block, variant):
            raise UserError(f"Ablation: {_label(variant)} cannot be the {block} of a FluidsNet.")
        taken = {"model", *TRIVIAL_PREDICTORS, *BASELINES, *dir(nn.ModuleDict)}
        if not re.fullmatch("[a-z][a-z0-9_]*", name) or name in taken:
            raise UserError(
                f"Ablation: the name {name!r} is taken or has characters other than lower-case "
                "letters, digits and _; choose another."
            )
        self.block, self.variant, self.name = block, variant, name
        self._measured = False

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Add the twin to the module, before a checkpoint is read.

        Raises:
            UserError: The module is not a FluidsNet, the twin would not differ, two twins have one
                name, or the losses are scaled.
        """
        module = require_fluidsnet(self, pl_module)
        callbacks: list[Callback] = trainer.callbacks  # type: ignore[attr-defined]
        ablations = [callback for callback in callbacks if isinstance(callback, Ablation)]
        if sum(ablation.name == self.name for ablation in ablations) > 1:
            raise UserError(f"Two callbacks Ablation have the name {self.name!r}.")
        if stage == "fit" and getattr(trainer.precision_plugin, "scaler", None) is not None:
            raise UserError(
                "With precision 16-mixed a step that overflows in one model is left out in both, "
                "which couples them; use bf16-mixed or 32."
            )
        twin = module.model.twin({self.block: deepcopy(self.variant)})
        known = module.named_models().get(self.name)
        if not same_settings(*(self._block_of(model) for model in (twin, known or module.model))):
            if known is not None:
                raise UserError(
                    f"This FluidsNet already has a twin {self.name!r} with another {self.block}; "
                    "choose another name."
                )
            module.add_model(self.name, twin)
        elif known is None:
            raise UserError(
                f"Ablation {self.name!r}: the model's own {self.block} is "
                f"{_label(self.variant)} with the same settings; name a variant that differs."
            )
        # The first ablation measures the cost for all.
        self._first = ablations[0] is self
        self._measured = stage != "fit"

    def _block_of(self, model: Model) -> Any:
        return model.blocks()[self.block]

    def charts(self, module: FluidsNet) -> Charts:
        """Return one chart for each figure, with all models."""
        names = module.named_models()
        return {
            "ablation": {
                figure: [f"ablation/{figure}/{name}" for name in names] for figure in _CHARTS
            }
        }

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the charts' layout for TensorBoard."""
        assert isinstance(pl_module, FluidsNet)
        self.write_charts(trainer, pl_module)

    def on_train_batch_start(
        self, trainer: Trainer, pl_module: LightningModule, batch: Transitions, batch_idx: int
    ) -> None:
        """Measure and log the cost of a training step, on copies of the models."""
        if self._measured or not self._first:
            return
        self._measured = True
        assert isinstance(pl_module, FluidsNet)
        costs = training_costs(
            pl_module.named_models(), batch, pl_module.optimizer, trainer.precision_plugin
        )
        figures = {
            f"ablation/cost/{figure}/{name}": value
            for name, cost in costs.items()
            for figure, value in cost.items()
        }
        for logger in trainer.loggers:
            logger.log_metrics(figures, step=trainer.global_step)
        seconds = ", ".join(f"{name} {cost['step_seconds']:.3g} s" for name, cost in costs.items())
        rank_zero_info(f"A training step of {batch.state.frames} frames takes: {seconds}.")


def _label(variant: Any) -> str:
    if variant is None or isinstance(variant, Sequence):
        return str(variant)
    named = getattr(variant, "func", variant)
    return str(getattr(named, "__name__", type(named).__name__))
