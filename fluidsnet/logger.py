"""TensorBoard logger whose scalars all belong to a group."""

from __future__ import annotations

from collections.abc import Mapping

from lightning.pytorch.loggers import TensorBoardLogger


class GroupedTensorBoardLogger(TensorBoardLogger):
    """Log the epoch, which Lightning adds to all metrics, as ``train/epoch``.

    TensorBoard groups scalars by the part of their name before the first ``/``.
    """

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        grouped = {"train/epoch" if name == "epoch" else name: metrics[name] for name in metrics}
        super().log_metrics(grouped, step)
