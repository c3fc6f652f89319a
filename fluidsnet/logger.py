"""TensorBoard's logger, with nothing outside a group."""

from __future__ import annotations

from collections.abc import Mapping

from lightning.pytorch.loggers import TensorBoardLogger


class GroupedTensorBoardLogger(TensorBoardLogger):
    """Lightning's, but the epoch, which Lightning logs by itself, is ``train/epoch``.

    TensorBoard groups scalars by what comes before the first ``/``.
    """

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        grouped = {"train/epoch" if name == "epoch" else name: metrics[name] for name in metrics}
        super().log_metrics(grouped, step)
