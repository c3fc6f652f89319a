"""Tests of the event files of a run against the table in docs/tensorboard.md."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import h5py
import lightning
import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar.layout_pb2 import Layout
from tensorboard.plugins.hparams.api_pb2 import STATUS_SUCCESS
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData
from tensorboard.util.tensor_util import make_ndarray

from fluidsnet.export.vtkhdf import read_frame
from fluidsnet.main import main

ROOT = Path(__file__).parents[1]

# It logs to the stderr that there is when it is loaded, which must not be one test's own.
assert lightning


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train an ablation from the command line, validate, test, predict; return the folder."""
    there = tmp_path_factory.mktemp("tensorboard")
    configs = (ROOT / "configs" / name for name in ("ablation/global_feature.yaml",))
    data = ROOT / "configs" / "data" / "sample.yaml"
    main(
        [
            "fit",
            *(f"--config={config}" for config in (*configs, data)),
            f"--data.init_args.root={ROOT / 'tests' / 'data' / 'dam_break'}",
            "--data.init_args.batch_size=2",
            "--trainer.max_steps=3",
            "--trainer.limit_val_batches=2",
            "--trainer.val_check_interval=3",
            "--trainer.log_every_n_steps=1",
            "--trainer.enable_progress_bar=false",
            f"--trainer.logger.init_args.save_dir={there}",
            "--trainer.logger.init_args.name=run",
            "--trainer.logger.init_args.version=",
        ]
    )
    run = there / "run"
    for word in ("validate", "test", "predict"):
        main([word, f"--run={run}"])
    return run


@pytest.fixture(scope="module")
def events(folder: Path) -> EventAccumulator:
    # All of each, as TensorBoard keeps a part of long series.
    return EventAccumulator(str(folder), size_guidance={"tensors": 0, "scalars": 0}).Reload()


def layout(events: EventAccumulator) -> dict[str, list[str]]:
    (event,) = events.Tensors("custom_scalars__config__")
    found = Layout.FromString(event.tensor_proto.string_val[0])
    return {
        f"{category.title}: {chart.title}": list(chart.multiline.tag)
        for category in found.category
        for chart in category.chart
    }


def hyperparameters(events: EventAccumulator) -> dict[str, HParamsPluginData]:
    return {
        tag.rpartition("/")[2]: HParamsPluginData.FromString(content)
        for tag, content in events.PluginTagToContent("hparams").items()
    }


def shown(events: EventAccumulator) -> Iterator[tuple[str, str]]:
    """Yield tab and tag of everything in the event files."""
    tags = events.Tags()
    yield from (("Scalars", tag) for tag in tags["scalars"])
    yield from (("Images", tag) for tag in tags["images"])
    yield from (("Custom Scalars", title) for title in layout(events))
    for tag in tags["tensors"]:
        plugin = events.SummaryMetadata(tag).plugin_data.plugin_name
        if plugin == "mesh":
            yield "Mesh", tag.removesuffix("_VERTEX").removesuffix("_COLOR")
        elif plugin == "text":
            yield "Text", tag.removesuffix("/text_summary")
        else:
            assert plugin == "custom_scalars", tag
    found = hyperparameters(events)
    yield from (
        ("HParams", name) for name in found["session_start_info"].session_start_info.hparams
    )
    for metric in found["experiment"].experiment.metric_infos:
        yield "HParams metrics", metric.name.tag


def promised() -> list[tuple[str, str]]:
    """Return tab and tag (a pattern) of each row in the table of the docs."""
    text = (ROOT / "docs" / "tensorboard.md").read_text()
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")][1:]
    return [
        (row[0].removeprefix("| "), re.sub("<[a-z]+>", "[^/]+", re.escape(tag)))
        for row in rows
        for tag in re.findall("`([^`]+)`", row[1])
    ]


def test_the_docs_name_all_that_is_there_and_nothing_else(events: EventAccumulator) -> None:
    rows, there = promised(), set(shown(events))
    assert len(rows) > 50

    def named(tab: str, tag: str) -> bool:
        return any(tab == row and re.fullmatch(pattern, tag) for row, pattern in rows)

    assert not sorted(f"{tab}: {tag}" for tab, tag in there if not named(tab, tag))
    # Without twins, the learning rate has no model's name.
    there.add(("Scalars", "train/learning_rate"))
    assert not [
        (row, pattern)
        for row, pattern in rows
        if not any(tab == row and re.fullmatch(pattern, tag) for tab, tag in there)
    ]


def test_each_chart_has_curves(events: EventAccumulator) -> None:
    scalars = events.Tags()["scalars"]
    charts = layout(events)
    assert charts["training: loss"] == ["train/loss", "val/loss"]
    for title, patterns in charts.items():
        for pattern in patterns:
            found = [tag for tag in scalars if re.match(pattern, tag)]
            assert found, title
            if title.startswith("rollout"):
                assert len(found) == 5  # both models, floor, constant velocity, ballistic


def test_hyperparameters_are_plain_and_training_ended(events: EventAccumulator) -> None:
    found = hyperparameters(events)
    values = found["session_start_info"].session_start_info.hparams
    assert values["block/target"].string_value == "VelocityTarget"
    assert values["block/global_feature"].string_value == "GlobalVector"
    assert values["block/noise"].string_value == "none"
    assert values["model/head"].string_value == "32 16 8"
    assert values["train/learning_rate"].number_value == 0.003
    assert values["data/time_step"].number_value == pytest.approx(0.02)
    assert found["session_end_info"].session_end_info.status == STATUS_SUCCESS


def test_the_parts_of_a_step_make_it_up(events: EventAccumulator) -> None:
    values = {
        tag.partition("/")[2]: [event.value for event in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
        if tag.startswith("speed/")
    }
    # The first of the three steps is left out.
    assert all(len(of) == 2 for of in values.values())
    assert [event.step for event in events.Scalars("speed/step_seconds")] == [1, 2]
    for index in range(2):
        now = {name: of[index] for name, of in values.items()}
        parts = now["data_seconds"] + now["search_seconds"] + now["network_seconds"]
        assert parts == pytest.approx(now["step_seconds"], rel=1e-4)
        assert now["steps_per_second"] == pytest.approx(1 / now["step_seconds"], rel=1e-4)
        assert all(value > 0 for value in now.values())
        # Two frames of some hundred particles a step.
        assert 400 < now["particles_per_second"] / now["steps_per_second"] < 4000


def test_the_mesh_is_what_the_trajectory_file_has(events: EventAccumulator, folder: Path) -> None:
    (path,) = (folder / "results" / "dam_break" / "rollouts").glob("*.vtkhdf")
    tag = "rollout_3d/truth_and_prediction"
    points, paint = events.Tensors(f"{tag}_VERTEX"), events.Tensors(f"{tag}_COLOR")
    steps = [event.step for event in points]
    assert len(steps) == 9 and steps[0] == 0 and steps[-1] == 40
    assert steps == [event.step for event in paint]
    with h5py.File(ROOT / "tests" / "data" / "dam_break" / "test.h5") as file:
        truth = file["00000/position"][()]
    for index in (0, -1):
        place = make_ndarray(points[index].tensor_proto)[0]
        colors = make_ndarray(paint[index].tensor_proto)[0]
        position, _ = read_frame(path, steps[index])
        number = len(position)
        # Last come the truth's and the prediction's, each moved aside as a whole.
        for found, expected in (
            (place[-2 * number : -number], truth[steps[index]]),
            (place[-number:], position),
        ):
            aside = found - expected
            assert np.abs(aside - aside.mean(axis=0)).max() < 1e-5
        assert place[-2 * number : -number, 0].max() < 0 < place[-number:, 0].min()
        assert len(colors) == len(place)
    # From blue to white: never less blue than red.
    assert (colors[:, 2] >= colors[:, 0]).all() and len(np.unique(colors, axis=0)) > 20
