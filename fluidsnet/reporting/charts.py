"""Charts of several curves in TensorBoard's tab "Custom Scalars"."""

from __future__ import annotations

from abc import ABC, abstractmethod

from lightning import Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from fluidsnet.module import FluidsNet

#: Regular expressions that match the tags of a chart, by category and title.
Charts = dict[str, dict[str, list[str]]]


class ChartSource(ABC):
    """Interface of a callback with charts in TensorBoard.

    TensorBoard reads one layout per run, so each source calls `write_charts` when training starts,
    and the first source writes the charts of all.
    """

    @abstractmethod
    def charts(self, module: FluidsNet) -> Charts:
        """Return the charts of this source."""

    def write_charts(self, trainer: Trainer, module: FluidsNet) -> None:
        """Write the charts of all sources among the callbacks, if this is the first source."""
        callbacks = trainer.callbacks  # type: ignore[attr-defined]
        sources = [source for source in callbacks if isinstance(source, ChartSource)]
        if sources[0] is not self or not trainer.is_global_zero:
            return
        layout: dict[str, dict[str, list[object]]] = {}
        for source in sources:
            for category, charts in source.charts(module).items():
                for title, tags in charts.items():
                    layout.setdefault(category, {})[title] = ["Multiline", tags]
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                logger.experiment.add_custom_scalars(layout)
