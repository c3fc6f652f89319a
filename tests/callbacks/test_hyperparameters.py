"""Tests of hyperparameters in TensorBoard when a training is interrupted and resumed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from lightning import Callback, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.api_pb2 import STATUS_SUCCESS
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

from callbacks import HyperParameters
from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.features import NoGlobalFeature


class Breaks(Callback):
    """Raise an error in the first validation."""

    def on_validation_epoch_end(self, *_: Any) -> None:
        raise RuntimeError("the lights went out")


def plugin(folder: Path) -> dict[str, HParamsPluginData]:
    found = EventAccumulator(str(folder / "run")).Reload().PluginTagToContent("hparams")
    return {tag: HParamsPluginData.FromString(content) for tag, content in found.items()}


def test_a_training_that_broke_may_still_succeed(sample: Path, tmp_path: Path) -> None:
    def fit(*more: Callback) -> None:
        source = SPHDataModule(sample, voxel_size=0.25)
        logger = TensorBoardLogger(tmp_path, name="run", version="", default_hp_metric=False)
        runner = Trainer(
            accelerator="cpu",
            devices=1,
            max_epochs=1,
            limit_train_batches=1,
            limit_val_batches=1,
            num_sanity_val_steps=0,
            logger=logger,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            callbacks=[HyperParameters(metrics=["val/skill"]), *more],
        )
        try:
            runner.fit(FluidsNet(source.grid_shape, global_feature=NoGlobalFeature), source)
        finally:
            source.teardown("fit")
            logger.experiment.flush()

    with pytest.raises(RuntimeError, match="lights"):
        fit(Breaks())
    # TensorBoard would keep what is said first.
    found = plugin(tmp_path)
    assert "_hparams_/session_end_info" not in found
    start = found["_hparams_/session_start_info"].session_start_info.hparams
    assert start["block/global_feature"].string_value == "NoGlobalFeature"
    (metric,) = found["_hparams_/experiment"].experiment.metric_infos
    assert metric.name.tag == "val/skill"
    fit()
    end = plugin(tmp_path)["_hparams_/session_end_info"].session_end_info
    assert end.status == STATUS_SUCCESS
