"""TensorBoard's charts of several curves (its tab "Custom Scalars")."""

from __future__ import annotations

from abc import ABC, abstractmethod

from lightning import Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from fluidsnet.module import FluidsNet

#: By category, by title, what starts the tags of a chart's curves: regular expressions.
Charts = dict[str, dict[str, list[str]]]


class ChartSource(ABC):
    """A callback that has curves drawn into one chart.

    TensorBoard reads one layout of a run, so that sources must not write theirs by themselves:
    each calls `write_charts` when training starts, and the first of them writes all.
    """

    @abstractmethod
    def charts(self, module: FluidsNet) -> Charts:
        """Its charts."""

    def write_charts(self, trainer: Trainer, module: FluidsNet) -> None:
        """Writes the charts of all sources among the callbacks, if this is the first."""
        callbacks = trainer.callbacks  # type: ignore[attr-defined]
        sources = [other for other in callbacks if isinstance(other, ChartSource)]
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
