"""Tests of rollout metrics in validation and test."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from callbacks import Ablation, RolloutMetrics
from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.errors import UserError
from fluidsnet.features import NoGlobalFeature
from fluidsnet.integrator import Integrator
from fluidsnet.particles import Particles
from fluidsnet.rollout import rollout
from fluidsnet.target import AccelerationTarget, Motion

#: Folder in the folder of a run for results on the sample.
RESULTS = "results/dam_break"


def data(sample: Path) -> SPHDataModule:
    return SPHDataModule(sample, voxel_size=0.25)


def trainer(folder: Path, *callbacks: Any, **changes: Any) -> Trainer:
    return Trainer(
        **{
            "accelerator": "cuda" if torch.cuda.is_available() else "cpu",
            "devices": 1,
            "logger": TensorBoardLogger(folder, name="run", version=""),
            "enable_checkpointing": False,
            "enable_progress_bar": False,
            "enable_model_summary": False,
            "limit_train_batches": 2,
            "limit_val_batches": 1,
            "limit_test_batches": 1,
            "num_sanity_val_steps": 1,
            "log_every_n_steps": 1,
            "callbacks": list(callbacks),
            **changes,
        }
    )


def scalars(folder: Path) -> EventAccumulator:
    return EventAccumulator(str(folder / "run"), size_guidance={"scalars": 0}).Reload()


def trained(source: SPHDataModule, **changes: Any) -> FluidsNet:
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature, **changes)
    model.model.set_statistics(source.statistics, source.time_step)
    return model


class BlowsUp(Integrator):
    """Integrator that gives NaN in the third of the network's steps."""

    def __init__(self) -> None:
        self.calls = 0

    def displacement(self, particles: Particles, motion: Motion) -> torch.Tensor:
        # Without a displacement, the motion is the network's.
        self.calls += motion.displacement is None
        return motion.velocity * (torch.nan if self.calls == 3 else 0.02)


@pytest.mark.parametrize(
    ("changes", "at"),
    [
        ({"max_epochs": 4}, [4, 8]),
        ({"max_steps": 6, "max_epochs": -1, "limit_train_batches": None, "val_check_interval": 1,
          "check_val_every_n_epoch": None}, [2, 4, 6]),
    ],
)  # fmt: skip
def test_every_second_validation_is_logged(
    sample: Path, tmp_path: Path, changes: dict[str, Any], at: Sequence[int]
) -> None:
    runner = trainer(tmp_path, RolloutMetrics(steps=3, every_n_validations=2), **changes)
    source = data(sample)
    runner.fit(FluidsNet(source.grid_shape, global_feature=NoGlobalFeature), source)
    logged = scalars(tmp_path)
    for name in (
        "rollout/position_error_mm/3",
        "rollout/chamfer_mm/3",
        "rollout_predictors/mse_n_m2/1/ballistic",
    ):
        # Lightning counts from 0.
        assert [event.step + 1 for event in logged.Scalars(name)] == list(at)
    # What does not change is measured once, and logged with every rollout.
    others = logged.Scalars("rollout_predictors/chamfer_mm/3/ballistic")
    assert len({event.value for event in others}) == 1
    assert len({event.value for event in logged.Scalars("rollout/chamfer_mm/3")}) > 1


def test_a_checkpoint_can_monitor_what_every_validation_measures(
    sample: Path, tmp_path: Path
) -> None:
    saver = ModelCheckpoint(tmp_path / "kept", monitor="rollout/position_error_mm/2")
    rollouts = RolloutMetrics(steps=2, every_n_validations=1)
    runner = trainer(tmp_path, rollouts, saver, enable_checkpointing=True, max_epochs=2)
    source = data(sample)
    runner.fit(FluidsNet(source.grid_shape, global_feature=NoGlobalFeature), source)
    best = min(event.value for event in scalars(tmp_path).Scalars(str(saver.monitor)))
    assert float(saver.best_model_score or 0) == pytest.approx(best)


def test_the_test_leaves_a_table_a_figure_and_scalars(sample: Path, tmp_path: Path) -> None:
    source = data(sample)
    model = trained(source)
    runner = trainer(tmp_path, RolloutMetrics(steps=12, starts=[0, 0.75], costly_steps=[5]))
    runner.test(model, source, verbose=False)
    with (tmp_path / "run" / RESULTS / "rollout_metrics.csv").open() as file:
        table = {(row["predictor"], row["steps"]): row for row in csv.DictReader(file)}
    with h5py.File(sample / "test.h5") as file_:
        position = file_["00000/position"][()].astype(np.float64)
        velocity = file_["00000/velocity"][()].astype(np.float64)
    frames = len(position)
    starts = (0, round(0.75 * (frames - 1)))
    there = [[start for start in starts if start + step < frames] for step in (1, 10, 12)]
    assert [len(some) for some in there] == [2, 2 if frames > 40 else 1, 1]
    for step, some in zip((1, 10, 12), there, strict=True):
        flown = [
            np.linalg.norm(
                position[at] + 0.02 * step * velocity[at] - position[at + step], axis=1
            ).mean()
            for at in some
        ]
        row = table["constant velocity", str(step)]
        assert float(row["position_error mm"]) == pytest.approx(1000 * np.mean(flown), rel=1e-4)
        assert row["simulations"] == "1"
        energy = [(velocity[at + step] ** 2).sum(axis=1).mean() / 2 for at in some]
        found = float(table["truth", str(step)]["kinetic_energy J/kg"])
        assert found == pytest.approx(np.mean(energy), rel=1e-4)
        states = []
        for at in some:
            start = source.rollout_starts("test", (at,))[0].state.to(model.device)
            states.append(list(rollout(model.eval().model, start, step))[-1].position.cpu().numpy())
        off = [
            np.linalg.norm(state - position[at + step], axis=1).mean()
            for state, at in zip(states, some, strict=True)
        ]
        mine = float(table["model", str(step)]["position_error mm"])
        assert mine == pytest.approx(1000 * np.mean(off), rel=1e-3)
    assert table["model", "1"]["chamfer mm"] == table["truth", "5"]["chamfer mm"] == ""
    assert float(table["model", "5"]["chamfer mm"]) > 0
    assert float(table["truth", "12"]["density_error 99.9th %"]) < 5
    assert (tmp_path / "run" / RESULTS / "rollout_metrics.png").stat().st_size > 10_000
    logged = scalars(tmp_path)
    assert {"test_rollout/position_error_mm", "test_rollout/kinetic_energy_j_per_kg"} <= set(
        logged.Tags()["images"]
    )
    (event,) = logged.Scalars("test_rollout/position_error_mm/1")
    assert event.value == pytest.approx(float(table["model", "1"]["position_error mm"]))


def test_a_rollout_that_blows_up_is_infinite_and_named(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = data(sample)
    model = trained(source, integrator=BlowsUp())
    # The first of its steps is that of the one batch, the third the rollout's second.
    trainer(tmp_path, RolloutMetrics(steps=3)).test(model, source, verbose=False)
    sentence = "The model's rollout of /00000 from frame 0 is not finite from step 2 on."
    assert sentence in capsys.readouterr().out
    assert sentence in (tmp_path / "run" / RESULTS / "rollout_metrics.md").read_text()
    with (tmp_path / "run" / RESULTS / "rollout_metrics.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["predictor"] == "model"]
    assert [row["non-finite %"] for row in rows] == ["0.0", "100.0", "100.0"]
    assert [row["position_error mm"] == "inf" for row in rows] == [False, True, True]
    assert rows[-1]["density_error %"] == rows[-1]["sinkhorn_256 m²"] == "inf"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"steps": 0}, "steps is 0"),
        ({"simulations": 0}, "simulations is 0"),
        ({"every_n_validations": -1}, "every_n_validations is -1"),
        ({"starts": []}, "give at least one"),
        ({"starts": [1.0]}, r"starts is \[1.0\]"),
        ({"starts": [-1]}, r"starts is \[-1\]"),
        ({"costly_steps": [0]}, r"costly_steps is \[0\]"),
        ({"name": "In motion"}, "name is 'In motion'; it is taken or has"),
        ({"name": "predictors"}, "name is 'predictors'; it is taken"),
        ({"name": "predict"}, "name is 'predict'; it is taken"),
    ],
)
def test_arguments_that_cannot_be_used(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        RolloutMetrics(**arguments)


def test_those_with_a_name_measure_apart(sample: Path, tmp_path: Path) -> None:
    """Each callback gives the results that it gives alone."""
    source = data(sample)
    changes: dict[str, Any] = {"steps": 3, "every_n_validations": 2}
    both = (RolloutMetrics(**changes), RolloutMetrics(starts=[0.5], name="late", **changes))
    runner = trainer(tmp_path, *both, max_epochs=2)
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature)
    runner.fit(model, source)
    assert {"rollout/kinetic_energy/3", "rollout_late/kinetic_energy/3"} <= set(
        runner.callback_metrics
    )
    runner.save_checkpoint(tmp_path / "two.ckpt")
    kept = torch.load(tmp_path / "two.ckpt", weights_only=False)["callbacks"]
    assert kept["RolloutMetrics"] == kept["RolloutMetrics_late"] == {"validations": 2}
    charts = {**both[0].charts(model), **both[1].charts(model)}
    assert list(charts) == ["rollout", "rollout_late"]
    assert charts["rollout_late"]["position error after 1 steps, mm"] == [
        "rollout_late(_predictors)?/position_error_mm/1(/|$)"
    ]
    runner.test(model, source, verbose=False)
    run, alone = tmp_path / "run", tmp_path / "alone"
    trainer(alone, RolloutMetrics(starts=[0.5], **changes)).test(model, source, verbose=False)
    late = (run / RESULTS / "rollout_metrics_late.csv").read_text()
    assert late == (alone / "run" / RESULTS / "rollout_metrics.csv").read_text()
    assert late != (run / RESULTS / "rollout_metrics.csv").read_text()
    assert (run / RESULTS / "rollout_metrics_late.png").exists()
    newest = max(run.glob("events.out*"), key=lambda path: path.stat().st_mtime_ns)
    tags = EventAccumulator(str(newest)).Reload().Tags()
    assert {"test_rollout/position_error_mm/1", "test_rollout_late/position_error_mm/1"} <= set(
        tags["scalars"]
    )
    assert "test_rollout_late/position_error_mm" in tags["images"]


def test_what_is_logged_beside_stands_at_the_same_steps(sample: Path, tmp_path: Path) -> None:
    runner = trainer(
        tmp_path,
        RolloutMetrics(steps=2, every_n_validations=1),
        max_epochs=1,
        limit_train_batches=6,
        val_check_interval=3,
        accumulate_grad_batches=2,
    )
    source = data(sample)
    runner.fit(FluidsNet(source.grid_shape, global_feature=NoGlobalFeature), source)
    mine, others = (
        [event.step for event in scalars(tmp_path).Scalars(tag)]
        for tag in ("rollout/mse_n_m2/1", "rollout_predictors/mse_n_m2/1/ballistic")
    )
    assert mine == others and len(mine) == 2


def test_another_module_or_other_data_are_refused(sample: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="RolloutMetrics needs the model FluidsNet"):
        RolloutMetrics().setup(trainer(tmp_path), LightningModule(), "test")
    with pytest.raises(UserError, match="a data module with rollout_starts"):
        RolloutMetrics().setup(trainer(tmp_path), trained(data(sample)), "test")


def test_none_is_measured_where_none_is_asked_for(sample: Path, tmp_path: Path) -> None:
    source = data(sample)
    runner = trainer(tmp_path, RolloutMetrics(every_n_validations=0), max_epochs=1)
    runner.fit(FluidsNet(source.grid_shape, global_feature=partial(NoGlobalFeature)), source)
    assert not [name for name in runner.callback_metrics if name.startswith("rollout/")]


def test_models_side_by_side_are_rolled_out_each(sample: Path, tmp_path: Path) -> None:
    """Each model gives the results that it gives alone."""
    source = data(sample)
    callbacks = (
        Ablation("target", AccelerationTarget(), "acceleration"),
        RolloutMetrics(steps=5, simulations=1, every_n_validations=1),
    )
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature)
    runner = trainer(tmp_path, *callbacks, max_epochs=1)
    runner.fit(model, source)
    runner.test(model, source, verbose=False)
    logged = [
        EventAccumulator(str(path)).Reload() for path in (tmp_path / "run").glob("events.out*")
    ]
    found = {tag: of for of in logged for tag in of.Tags()["scalars"]}

    def last(tag: str) -> float:
        return float(found[tag].Scalars(tag)[-1].value)

    for group in ("rollout", "test_rollout"):
        for figure in ("position_error_mm/5", "chamfer_mm/5", "kinetic_energy/2"):
            mine = last(f"{group}/{figure}")
            assert last(f"ablation_{group}/{figure}/model") == pytest.approx(mine)
            twin = last(f"ablation_{group}/{figure}/acceleration")
            assert np.isfinite(twin)
            assert twin != mine
    with (tmp_path / "run" / RESULTS / "rollout_metrics.csv").open() as file:
        table = {(row["predictor"], row["steps"]): row for row in csv.DictReader(file)}
    start = source.rollout_starts("test", [0], 5, 1)[0]
    for name, of in model.named_models().items():
        *_, state = rollout(of, start.state, 5)
        error = 1000 * (state.position - start.truth[5][0]).norm(dim=1).mean()
        row = table[name, "5"]
        assert float(row["position_error mm"]) == pytest.approx(float(error), rel=1e-4)
