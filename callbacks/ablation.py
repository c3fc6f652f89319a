"""Two models that differ in one block, trained side by side."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.utilities import rank_zero_info
from torch import nn

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.errors import UserError
from fluidsnet.features.local import LocalFeature
from fluidsnet.integrator import Integrator
from fluidsnet.metrics.rollout_suite import BESIDE
from fluidsnet.module import FluidsNet
from fluidsnet.neighbors import NeighborSearch
from fluidsnet.network import GlobalFeatureFactory
from fluidsnet.noise import StartNoise
from fluidsnet.particles import Transitions
from fluidsnet.reporting.charts import Charts, ChartSource
from fluidsnet.same_settings import same_settings
from fluidsnet.target import Target
from fluidsnet.training_cost import training_costs
from fluidsnet.walls import Walls

#: What takes a block's place.
Variant = (
    None
    | list[int]
    | Target
    | LocalFeature
    | Integrator
    | Walls
    | NeighborSearch
    | StartNoise
    | GlobalFeatureFactory
)

_KINDS: dict[str, type | tuple[type, ...]] = {
    "neighbors": NeighborSearch,
    "local": LocalFeature,
    "target": Target,
    "integrator": Integrator,
    "walls": Walls,
    "head": Sequence,
    "noise": (StartNoise, type(None)),
}
#: The figures that are compared while training, all but the first in one unit for both models.
_CHARTS = ("train_loss", "velocity_mse", "skill", "position_error_1_mm")


class Ablation(Callback, ChartSource):
    """Trains, beside the model, a twin of it with another block in one place.

    Both start from the same weights wherever these have a counterpart, see the same batches
    with the same noise, and have their gradients clipped apart. The model trains as it would
    alone, bit for bit. Every validation logs `velocity_mse`, `skill` and `position_error_1_mm`
    of the two, as ``ablation/<figure>/model`` and ``ablation/<figure>/<name>``, which
    TensorBoard shows in one chart (tab "Custom Scalars"); every training step their losses,
    each in the units of its own target. What a training step of each costs is measured once, on
    the first batch (``ablation/cost/…``). `OneStepTable` has a row for the twin.

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
        block: that differs; an argument of `FluidsNet`: neighbors, local, global_feature, target,
            integrator, walls, head or noise. Optimizer and schedule are for both.
        variant: the twin's; None is for no noise.
        name: of the twin, in logs and tables: lower-case letters, digits and ``_``.

    Raises:
        UserError: there is no such block, the variant is none of its kind, or the name is
            taken.
    """

    def __init__(self, block: str, variant: Variant = None, name: str = "twin") -> None:
        if block not in (*_KINDS, "global_feature"):
            raise UserError(
                f"Ablation: there is no block {block!r}; the blocks are "
                f"{', '.join(sorted((*_KINDS, 'global_feature')))}."
            )
        if not _fits(block, variant):
            raise UserError(f"Ablation: {_words(variant)} cannot be the {block} of a FluidsNet.")
        taken = {"model", *TRIVIAL_PREDICTORS, *BESIDE, *dir(nn.ModuleDict)}
        if not re.fullmatch("[a-z][a-z0-9_]*", name) or name in taken:
            raise UserError(
                f"Ablation: the name {name!r} is taken or has other signs than lower-case "
                "letters, digits and _; choose another."
            )
        self.block, self.variant, self.name = block, variant, name
        self._measured = False

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Makes the twin; a checkpoint is read after this.

        Raises:
            UserError: the module is not a FluidsNet, the twin would not differ, two twins have one
                name, or the losses are scaled.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("Ablation makes twins of FluidsNet alone.")
        ablations = [other for other in _callbacks(trainer) if isinstance(other, Ablation)]
        if sum(other.name == self.name for other in ablations) > 1:
            raise UserError(f"Two callbacks Ablation have the name {self.name!r}.")
        if stage == "fit" and getattr(trainer.precision_plugin, "scaler", None) is not None:
            raise UserError(
                "With precision 16-mixed a step that overflows in one model is left out in both, "
                "which couples them; use bf16-mixed or 32."
            )
        twin = pl_module.twin({self.block: deepcopy(self.variant)})
        known = pl_module.models().get(self.name)
        if known is None:
            if same_settings(pl_module.blocks()[self.block], twin.blocks()[self.block]):
                raise UserError(
                    f"Ablation {self.name!r}: the model's own {self.block} is "
                    f"{_words(self.variant)} with the same settings; name a variant that differs."
                )
            pl_module.add_twin(self.name, twin)
        elif not same_settings(known.blocks()[self.block], twin.blocks()[self.block]):
            raise UserError(
                f"This FluidsNet already has a twin {self.name!r} with another {self.block}; "
                "choose another name."
            )
        # Of several, the first measures for all.
        self._first = ablations[0] is self
        self._measured = stage != "fit"

    def charts(self, module: FluidsNet) -> Charts:
        """One a figure, with all models."""
        charts = {
            figure: [f"ablation/{figure}/{name}" for name in module.models()] for figure in _CHARTS
        }
        return {"ablation": charts}

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Tells TensorBoard to draw the models into one chart a figure."""
        assert isinstance(pl_module, FluidsNet)
        self.write_charts(trainer, pl_module)

    def on_train_batch_start(
        self, trainer: Trainer, pl_module: LightningModule, batch: Transitions, batch_idx: int
    ) -> None:
        """Measures what the first step costs, on copies."""
        if self._measured or not self._first:
            return
        self._measured = True
        assert isinstance(pl_module, FluidsNet)
        costs = training_costs(
            pl_module.models(), batch, pl_module.optimizer, trainer.precision_plugin
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


def _callbacks(trainer: Trainer) -> list[Callback]:
    found: list[Callback] = trainer.callbacks  # type: ignore[attr-defined]
    return found


def _fits(block: str, variant: Variant) -> bool:
    if block != "global_feature":
        return isinstance(variant, _KINDS[block]) and not isinstance(variant, str)
    # A factory is a class or a function; other blocks can be called, too, and are none.
    others = tuple(kind for kind in _KINDS.values() if kind is not Sequence)
    return callable(variant) and not isinstance(variant, others)


def _words(variant: Any) -> str:
    if variant is None or isinstance(variant, Sequence):
        return str(variant)
    named = getattr(variant, "func", variant)
    return str(getattr(named, "__name__", type(named).__name__))
