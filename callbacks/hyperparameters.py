"""Hyperparameters and metrics of a run for TensorBoard's tab HParams."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any

from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from tensorboard.compat.proto.summary_pb2 import Summary, SummaryMetadata
from tensorboard.plugins.hparams.api_pb2 import STATUS_SUCCESS
from tensorboard.plugins.hparams.metadata import (
    PLUGIN_DATA_VERSION,
    PLUGIN_NAME,
    SESSION_END_INFO_TAG,
)
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData, SessionEndInfo
from torch.utils.tensorboard.summary import hparams

from fluidsnet.module import FluidsNet
from fluidsnet.reporting.requirements import require_fluidsnet

Plain = bool | int | float | str

#: Blocks that are shown; TensorBoard sorts by name and shows the first five by default.
_BLOCKS = ("global_feature", "integrator", "local", "noise", "prior", "target", "walls")
#: Attributes of the data module that are shown.
_OF_DATA = ("stride", "time_step", "voxel_size", "steps", "batch_size")


class HyperParameters(Callback):
    """Write a run's blocks and settings for TensorBoard's tab "HParams", with its metrics.

    They are written when training starts. TensorBoard shows the latest value of each metric, also
    of a later ``test`` of the run, and leaves metrics that are not logged empty. TensorBoard reads
    the first settings in a folder only: the logger needs ``default_hp_metric: false``, since
    Lightning would write others first, and a new training needs a new folder. A resumed training
    keeps its row.

    Args:
        metrics: Tags of scalars.
    """

    def __init__(
        self,
        metrics: Sequence[str] = (
            "val/skill",
            "val/velocity_mse",
            "rollout/position_error_mm/25",
            "test/model/skill",
            "test_rollout/position_error_mm/25",
        ),
    ) -> None:
        self.metrics = list(metrics)

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Check the module."""
        require_fluidsnet(self, pl_module)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write hyperparameters and the names of the metrics, whose values are scalars."""
        settings = hyperparameters(trainer, require_fluidsnet(self, pl_module))
        names = dict.fromkeys(self.metrics, 0.0)
        experiment, start, _ = hparams(settings, names)  # type: ignore[no-untyped-call]
        self._write(trainer, experiment, start)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write that training succeeded."""
        self._write(trainer, _success())

    @staticmethod
    def _write(trainer: Trainer, *summaries: Any) -> None:
        if not trainer.is_global_zero:
            return
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                for summary in summaries:
                    logger.experiment._get_file_writer().add_summary(summary)


def hyperparameters(trainer: Trainer, module: FluidsNet) -> dict[str, Plain]:
    """Return the settings of a run as plain values.

    Args:
        trainer: Trainer at the start of training.
        module: Module that it trains.
    """
    settings: dict[str, Plain] = {}
    for name in _BLOCKS:
        block = module.model.blocks()[name]
        settings[f"block/{name}"] = "none" if block is None else type(block).__name__
    settings["model/head"] = " ".join(map(str, module.model.network.head.widths[1:-1]))
    settings["model/k"] = module.model.network.neighbors.k
    settings["model/weights"] = sum(weight.numel() for weight in module.model.parameters())
    data = getattr(trainer, "datamodule", None)
    settings |= {f"data/{name}": getattr(data, name) for name in _OF_DATA if hasattr(data, name)}
    optimizer = trainer.optimizers[0]
    group = optimizer.param_groups[0]
    # With a schedule, the rate that it starts from.
    settings["train/learning_rate"] = float(group.get("initial_lr", group["lr"]))
    settings["train/optimizer"] = type(optimizer).__name__
    settings["train/weight_decay"] = float(group.get("weight_decay", 0.0))
    for config in trainer.lr_scheduler_configs[:1]:
        settings["train/schedule"] = type(config.scheduler).__name__
    settings["train/precision"] = str(trainer.precision)
    settings["train/processes"] = trainer.world_size
    settings["train/seed"] = int(os.environ.get("PL_GLOBAL_SEED", -1))
    return settings


def _success() -> Any:
    """Return the summary of a successful run; TensorBoard's function for it needs TensorFlow."""
    end = SessionEndInfo(status=STATUS_SUCCESS, end_time_secs=time.time())
    content = HParamsPluginData(version=PLUGIN_DATA_VERSION, session_end_info=end)
    plugin = SummaryMetadata.PluginData(
        plugin_name=PLUGIN_NAME, content=content.SerializeToString()
    )
    metadata = SummaryMetadata(plugin_data=plugin)
    return Summary(value=[Summary.Value(tag=SESSION_END_INFO_TAG, metadata=metadata)])
