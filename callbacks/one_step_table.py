"""The test's figures beside the trivial predictors'."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet
from fluidsnet.reporting.run_folder import run_folder
from fluidsnet.reporting.table import Cell, write_table


class OneStepTable(Callback):
    """After ``test``, writes ``one_step.md`` and ``one_step.csv`` into the run's folder.

    A row a predictor: the model, the models that were trained beside it (`Ablation`), constant
    velocity and ballistic, each one step from the true states of the test split. It also
    prints the table.
    """

    _columns = ("skill", "velocity_mse", "position_error_1_mm")
    _header = ("one step ahead", "skill", "velocity_mse m²/s²", "position_error_1 mm")

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Learns the run's folder.

        Raises:
            UserError: the module is not a FluidsNet.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("OneStepTable compares the predictions of FluidsNet alone.")
        self._folder, self._module = run_folder(trainer), pl_module

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
            for predictor in (*self._module.named_models(), *TRIVIAL_PREDICTORS)
        ]
        path = self._folder / "one_step"
        print(f"\n{write_table(path, self._header, rows)}\n{path}.md")
