"""The test's figures beside the trivial predictors'."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from callbacks.folder import run_folder
from callbacks.table import Cell, write_table
from fluidsnet.module import PREDICTORS


class OneStepTable(Callback):
    """After ``test``, writes ``one_step.md`` and ``one_step.csv`` into the run's folder.

    A row a predictor: the model, constant velocity and ballistic, each one step from the
    true states of the test split. It also prints the table.
    """

    _columns = ("skill", "velocity_mse", "position_error_1_mm")
    _header = ("one step ahead", "skill", "velocity_mse m²/s²", "position_error_1 mm")

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Learns the run's folder."""
        self._folder = run_folder(trainer)

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes and prints the table."""
        if not trainer.is_global_zero:
            return
        rows: list[list[Cell]] = [
            [
                predictor.replace("_", " "),
                *(
                    float(trainer.callback_metrics[f"test/{predictor}/{column}"])
                    for column in self._columns
                ),
            ]
            for predictor in PREDICTORS
        ]
        path = self._folder / "one_step"
        print(f"\n{write_table(path, self._header, rows)}\n{path}.md")
