"""The prior alone as a row beside the model that corrects it."""

from __future__ import annotations

from typing import final

from lightning import Callback, LightningModule, Trainer

from fluidsnet.reporting.requirements import require_fluidsnet
from fluidsnet.target import PriorAlone

#: Name of the prior in logs and tables.
NAME = "prior"


@final
class PriorBaseline(Callback):
    """Measure the prior of the model alone, in `test`, beside the model.

    A network is worth its cost only where it beats its own prior. Free fall is in the tables as
    `ballistic`, and a model without a network is its prior; both get no further row.

    Example:
        .. code-block:: yaml

            callbacks:
              - class_path: callbacks.PriorBaseline
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Add the prior to the models of the test, before a checkpoint is read."""
        module = require_fluidsnet(self, pl_module)
        model = module.model
        corrected = model.prior.describes and model.network.target.width > 0
        if stage == "test" and corrected and NAME not in module.named_models():
            module.add_model(NAME, model.twin({"target": PriorAlone()}))
