"""Progress bars of training, validation, test and prediction."""

from __future__ import annotations

import sys
from typing import Any

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import TQDMProgressBar

from fluidsnet.progress import Progress


class ConsoleProgress(TQDMProgressBar):
    """Lightning's progress bars, which become lines where output is not a terminal."""

    def init_sanity_tqdm(self) -> Any:
        return self._bar(self.sanity_check_description, leave=False)

    def init_train_tqdm(self) -> Any:
        return self._bar(self.train_description)

    def init_validation_tqdm(self) -> Any:
        fitting = self.trainer.state.fn == "fit"
        return self._bar(self.validation_description, position=int(fitting), leave=not fitting)

    def init_test_tqdm(self) -> Any:
        return self._bar(self.test_description)

    def init_predict_tqdm(self) -> Any:
        return self._bar(self.predict_description, unit="simulation")

    def on_test_batch_end(self, *args: Any, **kwargs: Any) -> None:
        super().on_test_batch_end(*args, **kwargs)
        _close_if_complete(self.test_progress_bar)

    def on_predict_batch_end(self, *args: Any, **kwargs: Any) -> None:
        super().on_predict_batch_end(*args, **kwargs)
        _close_if_complete(self.predict_progress_bar)

    def get_metrics(self, trainer: Trainer, pl_module: LightningModule) -> dict[str, Any]:
        """Return the metrics at the end of the bar, such as loss and skill."""
        metrics = dict(super().get_metrics(trainer, pl_module))
        # The version of the run; `RunSummary` prints the folder.
        metrics.pop("v_num", None)
        return metrics

    def _bar(self, description: str, **settings: Any) -> Progress:
        return _Bar(
            **{"unit": "batch", "leave": True, "smoothing": 0, **settings},
            desc=description,
            disable=self.is_disabled,
            dynamic_ncols=True,
            file=sys.stdout,
            bar_format=self.BAR_FORMAT,
        )


def _close_if_complete(bar: Any) -> None:
    """Close a bar before other callbacks print their tables below it."""
    if bar.n == bar.total:
        bar.close()


class _Bar(Progress):
    def set_description(self, desc: str | None = None, refresh: bool | None = True) -> None:
        """Set the description without the index of the only data loader."""
        super().set_description((desc or "").removesuffix(" DataLoader 0"), refresh)
