"""Progress bars of training, validation, test and prediction."""

from __future__ import annotations

import sys
from typing import Any

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import TQDMProgressBar

from fluidsnet.progress import Progress


class ConsoleProgress(TQDMProgressBar):
    """Lightning's progress bars as `Progress`: lines where output is not a terminal."""

    def init_sanity_tqdm(self) -> Any:
        return self._bar("checking", leave=False)

    def init_train_tqdm(self) -> Any:
        return self._bar("training", smoothing=0)

    def init_validation_tqdm(self) -> Any:
        fitting = self.trainer.state.fn == "fit"
        return self._bar("validating", position=int(fitting), leave=not fitting)

    def init_test_tqdm(self) -> Any:
        return self._bar("testing")

    def init_predict_tqdm(self) -> Any:
        return self._bar("predicting", unit="simulation", smoothing=0)

    def get_metrics(self, trainer: Trainer, pl_module: LightningModule) -> dict[str, Any]:
        """Return what the bar shows: loss and skill, without the version of the run."""
        metrics = dict(super().get_metrics(trainer, pl_module))
        metrics.pop("v_num", None)
        return metrics

    def _bar(self, description: str, **settings: Any) -> Progress:
        return Progress(
            **{"desc": description, "unit": "batch", "leave": True, **settings},
            disable=self.is_disabled,
            dynamic_ncols=True,
            file=sys.stdout,
            bar_format=self.BAR_FORMAT,
        )
