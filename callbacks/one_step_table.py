"""Table of one-step errors."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.reporting.requirements import require_fluidsnet
from fluidsnet.reporting.results import results_folder
from fluidsnet.reporting.table import Cell, write_table


class OneStepTable(Callback):
    """Write and print ``one_step.md`` and ``one_step.csv`` after ``test``.

    The model, its twins (`Ablation`), constant velocity and ballistic have a row each, with errors
    one step from the true states of the test split.
    """

    _columns = ("skill", "velocity_mse", "position_error_1_mm")
    _header = ("one step ahead", "skill", "velocity_mse m²/s²", "position_error_1 mm")

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Check the module, and look up the folder, all processes together."""
        require_fluidsnet(self, pl_module)
        if stage == "test":
            self._folder = results_folder(trainer)

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write and print the table."""
        if not trainer.is_global_zero:
            return
        models = require_fluidsnet(self, pl_module).named_models()
        rows: list[list[Cell]] = []
        for predictor in (*models, *TRIVIAL_PREDICTORS):
            tags = (f"test/{predictor}/{column}" for column in self._columns)
            values = (float(trainer.callback_metrics[tag]) for tag in tags)
            rows.append([predictor.replace("_", " "), *values])
        path = self._folder / "one_step"
        print(f"{write_table(path, self._header, rows)}{path}.md")
