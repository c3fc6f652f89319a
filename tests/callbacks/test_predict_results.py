"""Tests of the files of `test` and `predict`: order, missing truth, several data sets."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from lightning import Callback, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import callbacks
from callbacks import (
    EnergyRecord,
    OneStepTable,
    RolloutMesh,
    RolloutMetrics,
    RolloutPicture,
    RolloutProgress,
    TrajectoryWriter,
)
from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.errors import UserError
from fluidsnet.export.vtkhdf import read_attributes, read_field_data, read_frame
from fluidsnet.features import NoGlobalFeature
from fluidsnet.reporting.rollout_frames import Frame, speed_limit

NO_TABLE = "No state of the rollouts has a truth: there is no table of rollout metrics."


def trainer(folder: Path, *callbacks: Callback, **changes: Any) -> Trainer:
    return Trainer(
        **{
            "accelerator": "cpu",
            "devices": 1,
            "logger": TensorBoardLogger(folder, name="run", version=""),
            "callbacks": list(callbacks),
            **dict.fromkeys(("enable_checkpointing", "enable_progress_bar"), False),
            **{"enable_model_summary": False, "limit_test_batches": 1},
            **changes,
        }
    )


def made(root: Path, **options: Any) -> tuple[FluidsNet, SPHDataModule]:
    source = SPHDataModule(root, voxel_size=0.25, **options)
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature)
    model.model.set_statistics(source.statistics, source.time_step)
    for weight in model.parameters():
        weight.data.fill_(0.01)
    return model, source


def shortened(sample: Path, folder: Path, frames: int) -> Path:
    """Copy the sample, with so many frames in each simulation of test.h5."""
    shutil.copytree(sample, folder)
    with h5py.File(folder / "test.h5", "a") as file:
        for group in file.values():
            for name in ("position", "velocity"):
                group[name].resize(frames, axis=0)
            for name in ("time", "solver_seconds"):
                values = group[name][:frames]
                del group[name]
                group[name] = values
    return folder


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def results(root: Path, folder: Path, *observers: Callback, **options: Any) -> Path:
    """Predict, and return the folder of the results."""
    trainer(folder, *observers).predict(*made(root, **options))
    return folder / "run" / "results" / root.name


def test_the_order_of_callbacks_does_not_matter(sample: Path, tmp_path: Path) -> None:
    kinds: Sequence[type[Callback]] = (
        RolloutProgress,
        TrajectoryWriter,
        RolloutMetrics,
        RolloutPicture,
        RolloutMesh,
    )
    contents, events = [], []
    for name, order in (("forward", 1), ("reverse", -1)):
        run = results(sample, tmp_path / name, *(kind() for kind in kinds[::order]))
        names = ("rollout.png", "rollout_metrics_predict.csv", "rollouts/00000.vtkhdf")
        contents.append([(run / file).read_bytes() for file in names[:2]])
        events.append(EventAccumulator(str(tmp_path / name / "run")).Reload())
        assert (run / names[2]).exists()
    assert contents[0] == contents[1]
    tag = "rollout_3d/truth_and_prediction_VERTEX"
    meshes = [[event.tensor_proto for event in found.Tensors(tag)] for found in events]
    assert len(meshes[0]) == 9 and meshes[0] == meshes[1]


def test_predict_measures_as_test_does(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, source = made(sample)
    metrics = RolloutMetrics(steps=None, simulations=None, costly_steps=[10])
    runner = trainer(tmp_path, metrics, RolloutMetrics(starts=[0.5], name="late"))
    runner.test(model, source, verbose=False)
    capsys.readouterr()
    runner.predict(model, source)
    run = tmp_path / "run" / "results" / "dam_break"
    predicted = (run / "rollout_metrics_predict.csv").read_text()
    assert predicted == (run / "rollout_metrics.csv").read_text()
    assert len({row["predictor"] for row in rows(run / "rollout_metrics_predict.csv")}) == 5
    printed = capsys.readouterr().out
    assert printed.startswith("| steps") and "\n\n" not in printed
    assert printed.splitlines()[-1] == str(run / "rollout_metrics_predict.md")


def test_simulations_that_were_not_rolled_out_do_not_count(sample: Path, tmp_path: Path) -> None:
    root = shutil.copytree(sample, tmp_path / "data")
    shutil.copy(root / "train.h5", root / "test.h5")
    runner = trainer(tmp_path, RolloutMetrics(), limit_predict_batches=1)
    runner.predict(*made(root, rollout_steps=2))
    table = rows(tmp_path / "run" / "results" / "data" / "rollout_metrics_predict.csv")
    assert {(row["steps"], row["simulations"]) for row in table} == {("1", "1"), ("2", "1")}


def test_a_rollout_without_a_truth_is_written_and_drawn_alone(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = shortened(sample, tmp_path / "one_frame", 1)
    observers = (RolloutMetrics(), RolloutPicture(), RolloutMesh(), TrajectoryWriter())
    run = results(root, tmp_path, *observers, rollout_steps=4)
    assert not list(run.glob("*.csv")) and not list(run.glob("*.md"))
    printed = capsys.readouterr().out
    assert printed.count(NO_TABLE) == 1 and "|" not in printed
    assert "Prediction (right), without a truth, of simulation /00000" in printed
    with Image.open(run / "rollout.png") as picture:
        alone = picture.size
    fields = read_field_data(run / "rollouts" / "00000.vtkhdf")
    assert len(fields["time"]) == 5
    assert np.isnan(fields["position_error_mm"][1:]).all()
    assert np.isfinite(fields["escaped"]).all()
    assert np.isnan(read_frame(run / "rollouts" / "00000.vtkhdf", 4)[1]["position_error"]).all()
    attributes = read_attributes(run / "rollouts" / "00000.vtkhdf")
    assert attributes["particle_radius"] == pytest.approx(0.06)
    assert attributes["gravity"] == pytest.approx([0, -9.81, 0])
    assert attributes["dimension"] == 3
    # Three rows of one column in place of two.
    known = results(sample, tmp_path / "known", RolloutPicture(), rollout_steps=4)
    with Image.open(known / "rollout.png") as picture:
        assert picture.height == alone[1] and picture.width > 1.5 * alone[0]


def test_the_part_with_a_truth_has_a_table(sample: Path, tmp_path: Path) -> None:
    root = shortened(sample, tmp_path / "three_frames", 3)
    picture = RolloutPicture((0.5, 1.0))
    run = results(root, tmp_path, RolloutMetrics(), picture, TrajectoryWriter(), rollout_steps=4)
    table = [
        row for row in rows(run / "rollout_metrics_predict.csv") if row["predictor"] == "model"
    ]
    assert [row["steps"] for row in table] == ["1", "2"]
    assert all(row["simulations"] == "1" for row in table)
    assert float(table[1]["chamfer mm"]) > 0
    errors = read_field_data(run / "rollouts" / "00000.vtkhdf")["position_error_mm"]
    assert float(table[1]["position_error mm"]) == pytest.approx(errors[2])
    assert np.isnan(errors).tolist() == [False, False, False, True, True]
    assert list(picture.frames["truth"]) == [2] and list(picture.frames["model"]) == [2, 4]
    assert (run / "rollout.png").stat().st_size > 10_000


def test_the_color_scale_is_the_truths_if_it_is_known_after_the_start() -> None:
    def frame(speed: float) -> Frame:
        still = np.zeros((2, 3), np.float32)
        return Frame(still, still + np.float32(speed / 3**0.5), still[:0])

    assert speed_limit({"truth": {0: frame(1), 2: frame(3)}, "a": {2: frame(9)}}) < 3.01
    assert speed_limit({"truth": {0: frame(0)}, "a": {0: frame(0), 2: frame(9)}}) > 8.9
    assert speed_limit({"a": {2: frame(9)}}) == pytest.approx(9)


def test_results_on_several_data_sets_are_kept_apart(sample: Path, tmp_path: Path) -> None:
    def measure(root: Path) -> None:
        observers = (OneStepTable(), RolloutMetrics(steps=2), RolloutPicture(), TrajectoryWriter())
        model, source = made(root, rollout_steps=2)
        runner = trainer(tmp_path, *observers)
        runner.test(model, source, verbose=False)
        runner.predict(model, source)

    def contents(folder: Path) -> dict[str, bytes]:
        names = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return {str(path.relative_to(folder)): path.read_bytes() for path in names}

    other, same_name = tmp_path / "other", tmp_path / "elsewhere" / "dam_break"
    for root in (other, same_name):
        shutil.copytree(sample, root)
        with h5py.File(root / "test.h5", "a") as file:
            file["00000/velocity"][...] *= 0.5
    found = tmp_path / "run" / "results"
    measure(sample)
    first = contents(found / "dam_break")
    assert {"data.json", "one_step.csv", "rollout.png", "rollouts/00000.vtkhdf"} <= first.keys()
    assert {"rollout_metrics.csv", "rollout_metrics_predict.csv"} <= first.keys()
    measure(other)
    measure(same_name)
    measure(other)
    assert sorted(path.name for path in found.iterdir()) == ["dam_break", "dam_break_2", "other"]
    assert contents(found / "dam_break") == first
    for name, root in (("dam_break", sample), ("other", other), ("dam_break_2", same_name)):
        note = json.loads((found / name / "data.json").read_text())
        assert note["root"] == str(root) and note["frames"] == 41
    hashes = {json.loads(path.read_text())["sha256"] for path in found.glob("*/data.json")}
    assert len(hashes) == 2
    tables = [(found / name / "one_step.csv").read_text() for name in ("dam_break", "other")]
    assert tables[0] != tables[1]
    assert not [path for path in (tmp_path / "run").iterdir() if path.suffix in (".csv", ".png")]


def test_results_whose_note_is_damaged_are_not_overwritten(sample: Path, tmp_path: Path) -> None:
    model, source = made(sample)
    run = tmp_path / "run" / "results"
    for expected in ("dam_break", "dam_break_2"):
        trainer(tmp_path, OneStepTable()).test(model, source, verbose=False)
        assert (run / expected / "one_step.csv").exists()
        (run / "dam_break" / "data.json").write_text("{")


def test_starts_on_one_frame_count_apart(sample: Path, tmp_path: Path) -> None:
    model, source = made(sample)
    starts: tuple[int | float, ...]
    for name, starts in (("one", (0,)), ("two", (0, 0.0))):
        metrics = RolloutMetrics(steps=2, starts=starts, name=name)
        trainer(tmp_path, metrics).test(model, source, verbose=False)
    folder = tmp_path / "run" / "results" / "dam_break"
    one, two = ((folder / f"rollout_metrics_{name}.csv").read_text() for name in ("one", "two"))
    assert one == two
    assert metrics._suite is not None
    assert all(bool(metric.known.all()) for metric in metrics._suite.metrics["truth"][:1])


def test_each_module_in_the_folder_of_callbacks_has_a_callback() -> None:
    for path in sorted(Path(callbacks.__file__).parent.glob("[a-z]*.py")):
        module = import_module(f"callbacks.{path.stem}")
        classes = [value for value in vars(module).values() if isinstance(value, type)]
        own = [value for value in classes if value.__module__ == module.__name__]
        assert any(issubclass(value, Callback) for value in own), path


def test_energy_and_density_are_recorded_without_a_truth(sample: Path, tmp_path: Path) -> None:
    folder = results(sample, tmp_path, EnergyRecord(rows=4), rollout_steps=9)
    recorded = rows(folder / "energy.csv")
    first = [row for row in recorded if row["simulation"] == recorded[0]["simulation"]]
    assert [int(row["step"]) for row in first] == [0, 3, 6, 9]
    with h5py.File(sample / "test.h5") as file:
        group = file[first[0]["simulation"]]
        position, velocity = (group[name][0].astype(float) for name in ("position", "velocity"))
        lower, pull = file.attrs["domain_lower"], -file.attrs["gravity"][1]
    height = (position[:, 1] - lower[1]).mean()
    assert float(first[0]["potential J/kg"]) == pytest.approx(pull * height, rel=1e-5)
    kinetic = (velocity**2).sum(axis=1).mean() / 2
    assert float(first[0]["kinetic J/kg"]) == pytest.approx(kinetic, abs=1e-6)
    assert float(first[0]["escaped"]) == 0
    # The network's weights are constant: its velocities are those of the record.
    assert float(first[-1]["fastest m/s"]) ** 2 / 2 >= float(first[-1]["kinetic J/kg"])
    with Image.open(folder / "energy.png") as picture:
        assert picture.width > 1000


def test_a_record_of_one_row_is_refused() -> None:
    with pytest.raises(UserError, match="rows is 1; set at least 2"):
        EnergyRecord(rows=1)
