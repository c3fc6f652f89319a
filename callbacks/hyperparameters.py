"""What a run is made of beside what came out, for TensorBoard's tab HParams."""

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

from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet

Plain = bool | int | float | str

#: What figures depend on; TensorBoard sorts by name and shows the first five unless told otherwise.
_BLOCKS = ("global_feature", "integrator", "local", "noise", "target", "walls")
#: Of the data module, by its own names.
_OF_DATA = ("stride", "time_step", "voxel_size", "steps", "batch_size")


class HyperParameters(Callback):
    """Shows a run's blocks and settings beside its metrics, a run a row (tab "HParams").

    They are written when training starts; TensorBoard then shows the latest value of each metric,
    also of a later ``test`` of the run, and nothing for one that is not logged. The logger needs
    ``default_hp_metric: false``, or Lightning writes others first, and TensorBoard reads the first.
    For the same reason a training that is resumed in its folder keeps its row, and one that is
    begun anew in the folder of another shows the settings of that: give it a folder of its own.

    Args:
        metrics: tags of scalars.
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
        """Checks who is trained.

        Raises:
            UserError: the module is not a FluidsNet.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("HyperParameters knows the blocks of FluidsNet alone.")

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes what there is before the first step."""
        assert isinstance(pl_module, FluidsNet)
        # The names of the metrics alone; their values are scalars.
        names = dict.fromkeys(self.metrics, 0.0)
        experiment, start, _ = hparams(  # type: ignore[no-untyped-call]
            hyperparameters(trainer, pl_module), names
        )
        self._write(trainer, experiment, start)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Notes that training went to its end; one that did not may be resumed, and still do."""
        self._write(trainer, _succeeded())

    @staticmethod
    def _write(trainer: Trainer, *summaries: Any) -> None:
        if not trainer.is_global_zero:
            return
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                for summary in summaries:
                    logger.experiment._get_file_writer().add_summary(summary)


def hyperparameters(trainer: Trainer, module: FluidsNet) -> dict[str, Plain]:
    """Plain values that a run can be told from others by.

    Args:
        trainer: at the start of training.
        module: that it trains.
    """
    found: dict[str, Plain] = {}
    for name in _BLOCKS:
        block = module.model.blocks()[name]
        found[f"block/{name}"] = "none" if block is None else type(block).__name__
    found["model/head"] = " ".join(map(str, module.model.network.head.widths[1:-1]))
    found["model/k"] = module.model.network.neighbors.k
    found["model/weights"] = sum(weight.numel() for weight in module.model.parameters())
    data = getattr(trainer, "datamodule", None)
    found |= {f"data/{name}": getattr(data, name) for name in _OF_DATA if hasattr(data, name)}
    optimizer = trainer.optimizers[0]
    group = optimizer.param_groups[0]
    # What the schedule starts from, where there is one.
    found["train/learning_rate"] = float(group.get("initial_lr", group["lr"]))
    found["train/optimizer"] = type(optimizer).__name__
    found["train/weight_decay"] = float(group.get("weight_decay", 0.0))
    for config in trainer.lr_scheduler_configs[:1]:
        found["train/schedule"] = type(config.scheduler).__name__
    found["train/precision"] = str(trainer.precision)
    found["train/processes"] = trainer.world_size
    found["train/seed"] = int(os.environ.get("PL_GLOBAL_SEED", -1))
    return found


def _succeeded() -> Any:
    """What says that a run did; TensorBoard's own function for it needs TensorFlow."""
    end = SessionEndInfo(status=STATUS_SUCCESS, end_time_secs=time.time())
    content = HParamsPluginData(version=PLUGIN_DATA_VERSION, session_end_info=end)
    plugin = SummaryMetadata.PluginData(
        plugin_name=PLUGIN_NAME, content=content.SerializeToString()
    )
    metadata = SummaryMetadata(plugin_data=plugin)
    return Summary(value=[Summary.Value(tag=SESSION_END_INFO_TAG, metadata=metadata)])
