"""Tests of rollouts in TensorBoard's tab Mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lightning import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.util.tensor_util import make_ndarray

from callbacks import RolloutMesh
from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.errors import UserError
from fluidsnet.features import NoGlobalFeature
from fluidsnet.integrator import Integrator
from fluidsnet.particles import Particles
from fluidsnet.priors import Guess
from fluidsnet.statistics import Statistics
from fluidsnet.target import Motion, Target, VelocityTarget

TAG = "rollout_3d/truth_and_prediction"


class LosesTwo(Integrator):
    """Integrator that moves one particle far away and one to NaN."""

    def displacement(self, particles: Particles, motion: Motion) -> torch.Tensor:
        moved = torch.zeros_like(particles.position)
        moved[0], moved[1, 1] = 1000.0, torch.nan
        return moved


class Stays(Integrator):
    """Integrator that moves nothing."""

    def displacement(self, particles: Particles, motion: Motion) -> torch.Tensor:
        return torch.zeros_like(particles.position)


class Fast(Target):
    """Target with a constant velocity of 1 km/s."""

    width = 3

    def set_statistics(self, statistics: Statistics) -> None:
        pass

    def decode(self, output: torch.Tensor, particles: Particles, guess: Guess) -> Motion:
        return Motion(torch.full_like(output, 1000.0))

    def encode(
        self, particles: Particles, guess: Guess, position: torch.Tensor, velocity: torch.Tensor
    ) -> torch.Tensor:
        return velocity


def rolled_out(sample: Path, folder: Path, mesh: RolloutMesh, **blocks: Any) -> EventAccumulator:
    source = SPHDataModule(sample, voxel_size=0.25, rollout_steps=4)
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature, **blocks)
    model.model.set_statistics(source.statistics, source.time_step)
    Trainer(
        accelerator="cpu",
        devices=1,
        logger=TensorBoardLogger(folder, name="run", version=""),
        enable_progress_bar=False,
        enable_model_summary=False,
        callbacks=[mesh],
    ).predict(model, source)
    return EventAccumulator(str(folder / "run"), size_guidance={"tensors": 0}).Reload()


def points(events: EventAccumulator, kind: str = "VERTEX") -> list[np.ndarray]:
    return [make_ndarray(event.tensor_proto)[0] for event in events.Tensors(f"{TAG}_{kind}")]


def test_the_same_few_particles_are_shown_each_time_and_it_is_said(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    events = rolled_out(sample, tmp_path, RolloutMesh(times=3, particles=50))
    assert [event.step for event in events.Tensors(f"{TAG}_VERTEX")] == [0, 2, 4]
    shown = points(events)
    # Within a few steps of one another, so the same particles, and both start from the same.
    assert np.abs(shown[0][-100:-50] - shown[-1][-100:-50]).max() < 0.1
    aside = shown[0][-50:] - shown[0][-100:-50]
    assert np.abs(aside - aside[0]).max() < 1e-5 and aside[0, 0] > 0
    again = points(rolled_out(sample, tmp_path / "again", RolloutMesh(times=1, particles=50)))
    assert np.array_equal(again[0], shown[0])
    (legend,) = events.Tensors("rollout_3d/legend/text_summary")
    words = legend.tensor_proto.string_val[0].decode()
    assert "50 of " in words and "after 0, 2, 4 steps of 0.02 s" in words
    assert words in capsys.readouterr().out


def test_what_is_far_away_or_not_finite_is_left_out_and_counted(
    sample: Path, tmp_path: Path
) -> None:
    events = rolled_out(sample, tmp_path, RolloutMesh(times=2), integrator=LosesTwo())
    before, after = points(events)
    assert len(before) - len(after) == 2
    assert np.isfinite(after).all() and np.abs(after).max() < 10
    colors = points(events, "COLOR")
    assert [len(paint) for paint in colors] == [len(before), len(after)]
    (legend,) = events.Tensors("rollout_3d/legend/text_summary")
    words = legend.tensor_proto.string_val[0].decode()
    assert "2 times a particle of the prediction is too far away" in words
    assert "of the truth is" not in words


def test_the_scale_of_color_is_the_truths(sample: Path, tmp_path: Path) -> None:
    """A prediction that is far too fast leaves the colors of the truth."""
    paints = []
    for target in (VelocityTarget(), Fast()):
        folder = tmp_path / type(target).__name__
        mesh = RolloutMesh(times=2, particles=50)
        events = rolled_out(sample, folder, mesh, target=target, integrator=Stays())
        paints.append(points(events, "COLOR")[-1])
    truth, prediction = (
        [paint[part] for paint in paints] for part in (slice(-100, -50), slice(-50, None))
    )
    assert np.array_equal(*truth)
    assert (prediction[1] > 250).all() and not (prediction[0] > 250).all()


@pytest.mark.parametrize("name", ["times", "particles"])
def test_less_than_one_is_refused(name: str) -> None:
    with pytest.raises(UserError, match=f"{name} is 0"):
        RolloutMesh(**{name: 0})
