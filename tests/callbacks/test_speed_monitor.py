"""Tests of the measured speed of training."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch import Tensor

from callbacks import HyperParameters, LossChart, SpeedMonitor
from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.errors import UserError
from fluidsnet.features import NoGlobalFeature
from fluidsnet.particles import Transitions


class Slow(Callback):
    """Sleep 50 ms per batch and some seconds per validation; count the particles of each batch."""

    def __init__(self, validation: float = 0.0) -> None:
        self.validation = validation
        self.particles: list[int] = []

    def on_train_batch_start(
        self, trainer: Trainer, pl_module: LightningModule, batch: Transitions, batch_idx: int
    ) -> None:
        self.particles.append(len(batch.state))
        time.sleep(0.05)

    def on_validation_epoch_end(self, *_: Any) -> None:
        time.sleep(self.validation)


def fit(sample: Path, folder: Path, *callbacks: Callback, **changes: Any) -> dict[str, Tensor]:
    """Return the weights after eight batches and two validations."""
    torch.manual_seed(0)
    source = SPHDataModule(sample, voxel_size=0.25, batch_size=1, sample_every=6, steps=2)
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature)
    Trainer(
        **{
            "accelerator": "cuda" if torch.cuda.is_available() else "cpu",
            "devices": 1,
            "logger": TensorBoardLogger(folder, name="run", version=""),
            "enable_checkpointing": False,
            "enable_progress_bar": False,
            "enable_model_summary": False,
            "num_sanity_val_steps": 1,
            "limit_val_batches": 1,
            "max_epochs": 2,
            "limit_train_batches": 4,
            "log_every_n_steps": 2,
            "callbacks": list(callbacks),
            **changes,
        }
    ).fit(model, source)
    return model.state_dict()


def speeds(folder: Path) -> dict[str, list[tuple[int, float]]]:
    events = EventAccumulator(str(folder / "run"), size_guidance={"scalars": 0}).Reload()
    return {
        tag.partition("/")[2]: [(event.step, event.value) for event in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
        if tag.startswith("speed/")
    }


def test_training_is_the_same_with_and_without_it(sample: Path, tmp_path: Path) -> None:
    alone = fit(sample, tmp_path / "alone")
    watched = fit(sample, tmp_path / "watched", SpeedMonitor())
    assert all(torch.equal(value, watched[name]) for name, value in alone.items())


def test_batches_count_and_validations_do_not(sample: Path, tmp_path: Path) -> None:
    slow = Slow(validation=0.8)
    fit(sample, tmp_path, SpeedMonitor(), slow)
    found = speeds(tmp_path)
    # A validation follows the second interval; the first one lacks the first step.
    assert [step for step, _ in found["step_seconds"]] == [1, 3, 5, 7]
    assert all(0.05 < value < 0.4 for _, value in found["step_seconds"])
    # One frame, two steps of each particle; of the first interval the second batch alone.
    means = [
        slow.particles[1],
        *(sum(slow.particles[first : first + 2]) / 2 for first in (2, 4, 6)),
    ]
    for (_, particles), (_, steps), mean in zip(
        found["particles_per_second"], found["steps_per_second"], means, strict=True
    ):
        assert particles / steps == pytest.approx(2 * mean, rel=1e-3)
    assert all(value > 50 for _, value in found["peak_memory_mb"])


def test_a_step_may_be_several_batches(sample: Path, tmp_path: Path) -> None:
    fit(sample, tmp_path, SpeedMonitor(), Slow(), accumulate_grad_batches=2, log_every_n_steps=1)
    found = speeds(tmp_path)
    # The first of four is left out.
    assert len(found["step_seconds"]) == 3
    assert all(value > 0.1 for _, value in found["step_seconds"])


@pytest.mark.parametrize("callback", [SpeedMonitor, HyperParameters, LossChart])
def test_another_module_is_refused(callback: type[Callback]) -> None:
    with pytest.raises(UserError, match="needs the model FluidsNet"):
        callback().setup(Trainer(logger=False), LightningModule(), "fit")
