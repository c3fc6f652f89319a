"""Command line: every file in configs/ is run, on the sample."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import h5py
import lightning
import numpy as np
import pytest
import torch
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar.layout_pb2 import Layout

from datamodules.generate.bodies import Block, MovingBody, from_description
from datamodules.generate.command import _parser as generate_parser
from fluidsnet.arguments import with_base
from fluidsnet.errors import UserError
from fluidsnet.export.vtkhdf import read_field_data, read_frame
from fluidsnet.main import USAGE, main
from fluidsnet.models import shipped_models
from fluidsnet.models.loading import has_weights
from tools.demo import OF_IISPH
from tools.processes import started

ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"
TRAINER = CONFIGS / "trainer.yaml"
PAPER = CONFIGS / "model" / "paper.yaml"
SAMPLE = CONFIGS / "data" / "sample.yaml"
# Folder in the folder of a run for results on the sample.
RESULTS = Path("results") / "dam_break"

# It logs to the stderr that there is when it is loaded, which must not be one test's own.
assert lightning

Run = Callable[..., None]


@pytest.fixture
def run(sample: Path, tmp_path: Path) -> Run:
    """Runs a command with the sample as data and a temporary folder for what it leaves."""

    def run(word: str, *configs: Path, more: tuple[str, ...] = ()) -> None:
        arguments = [word, *(f"--config={config}" for config in configs)]
        if word == "fit":
            arguments += [
                f"--data.init_args.root={sample}",
                "--data.init_args.workers=0",
                "--trainer.max_epochs=1",
                "--trainer.limit_train_batches=2",
                "--trainer.limit_val_batches=2",
                "--trainer.enable_progress_bar=false",
                f"--trainer.logger.init_args.save_dir={tmp_path}",
                "--trainer.logger.init_args.name=run",
                "--trainer.logger.init_args.version=",
            ]
        main([*arguments, *more])

    return run


PRIOR = CONFIGS / "model" / "prior.yaml"
TRAINED = sorted(it for it in (CONFIGS / "model").glob("*.yaml") if has_weights(it))


@pytest.mark.parametrize("model", TRAINED, ids=lambda path: path.stem)
def test_every_model_trains_is_tested_and_rolls_out(
    model: Path, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("fit", TRAINER, model, SAMPLE)
    folder = tmp_path / "run"
    assert (folder / "config.yaml").exists()
    run("test", more=(f"--run={folder}",))
    with (folder / RESULTS / "one_step.csv").open() as file:
        rows = list(csv.reader(file))
    names = ["model", *(["prior"] if model.stem == "corrected" else [])]
    assert [row[0] for row in rows[1:]] == [*names, "constant velocity", "ballistic"]
    with (folder / RESULTS / "rollout_metrics.csv").open() as file:
        measured = [(row["predictor"], row["steps"]) for row in csv.DictReader(file)]
    assert {(name, "1") for name in names} | {("truth", "25")} <= set(measured)
    assert (folder / RESULTS / "rollout_metrics.png").exists()
    printed = capsys.readouterr().out
    assert (folder / RESULTS / "one_step.md").read_text() in printed
    run("predict", more=(f"--run={folder}", "--data.init_args.rollout_steps=3"))
    assert (folder / RESULTS / "rollout.png").stat().st_size > 10_000
    with (folder / RESULTS / "rollout_metrics_predict.csv").open() as file:
        table = [row for row in csv.DictReader(file) if row["predictor"] == "model"]
    assert [row["steps"] for row in table] == ["1", "2", "3"]
    assert len(list((folder / RESULTS / "rollouts").glob("*.vtkhdf"))) == 1
    # A later test or prediction leaves the training's own configuration in place.
    assert "rollout_steps: null" in (folder / "config.yaml").read_text()


def test_the_prior_alone_runs_without_training(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        run("fit", TRAINER, PRIOR, SAMPLE)
    assert "The prior PressureStep alone has no weights to train" in capsys.readouterr().err
    here = tuple(
        f"--trainer.logger.init_args.{name}={value}"
        for name, value in (("save_dir", tmp_path), ("name", "run"), ("version", ""))
    )
    for command in ("test", "predict"):
        run(command, TRAINER, PRIOR, SAMPLE, more=here)
    folder = tmp_path / "run" / RESULTS
    with (folder / "one_step.csv").open() as file:
        skills = {row["one step ahead"]: float(row["skill"]) for row in csv.DictReader(file)}
    assert list(skills) == ["model", "constant velocity", "ballistic"]
    assert skills["model"] > 0.7
    assert len(list((folder / "rollouts").glob("*.vtkhdf"))) == 1


def test_a_shipped_model_is_tested_predicts_and_is_reported(
    run: Run,
    sample: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    root = f"--data.init_args.root={sample}"
    for command in ("test", "predict"):
        run(command, more=("--run=dam_break_small", root, "--data.init_args.stride=1"))
    folder = tmp_path / "runs" / "dam_break_small"
    with (folder / RESULTS / "one_step.csv").open() as file:
        skills = {row["one step ahead"]: float(row["skill"]) for row in csv.DictReader(file)}
    assert list(skills) == ["model", "constant velocity", "ballistic"]
    assert skills["model"] > 0.9
    assert "PressureStep, PriorAlone, OpenWalls\nweights  none" in capsys.readouterr().out
    assert len(list((folder / RESULTS / "rollouts").glob("*.vtkhdf"))) == 1
    main(["report", "runs/dam_break_small"])
    assert "PressureStep" in (folder / "report" / "report.md").read_text()
    # A run of one's own in that folder is not overwritten.
    own = tmp_path / "runs" / "box_drops"
    (own / "checkpoints").mkdir(parents=True)
    with pytest.raises(SystemExit):
        run("test", more=("--run=box_drops", root))
    assert "runs/box_drops is the folder of a run of yours" in capsys.readouterr().err
    assert [path.name for path in own.iterdir()] == ["checkpoints"]
    with pytest.raises(SystemExit):
        run("test", more=("--run=box_drops_40ms", root, "--data.init_args.stride=1"))
    assert "prior is set for a time step of 0.04 s" in capsys.readouterr().err


def test_the_help_names_the_shipped_models() -> None:
    text = " ".join(USAGE.split())
    assert all(f"{name}," in text or f"{name}." in text for name in shipped_models())


ABLATIONS = sorted((CONFIGS / "ablation").glob("*.yaml"))


@pytest.mark.parametrize("ablation", ABLATIONS, ids=lambda p: p.stem)
def test_every_ablation_is_compared_while_training_and_in_the_test(
    ablation: Path, run: Run, tmp_path: Path
) -> None:
    run("fit", ablation, SAMPLE, more=("--trainer.max_steps=-1", "--trainer.log_every_n_steps=1"))
    folder = tmp_path / "run"
    callbacks = yaml.safe_load(ablation.read_text())["trainer"]["callbacks+"]
    name = callbacks[0]["init_args"]["name"]
    events = EventAccumulator(str(folder)).Reload()
    scalars = set(events.Tags()["scalars"])
    tensor = events.Tensors("custom_scalars__config__")[0].tensor_proto
    layout = Layout.FromString(tensor.string_val[0])
    (category,) = (one for one in layout.category if one.title == "ablation")
    charts = {chart.title: list(chart.multiline.tag) for chart in category.chart}
    figures = ["train_loss", "velocity_mse", "skill", "position_error_1_mm"]
    assert charts == {
        figure: [f"ablation/{figure}/model", f"ablation/{figure}/{name}"] for figure in figures
    }
    costs = ["step_seconds", "kept_bytes", "parameters", "optimizer_bytes"]
    costs = [f"ablation/cost/{cost}/{who}" for cost in costs for who in ("model", name)]
    assert {*costs, *(tag for tags in charts.values() for tag in tags)} <= scalars
    assert all(events.Scalars(cost)[0].value > 0 for cost in costs)
    run("test", more=(f"--run={folder}",))
    with (folder / RESULTS / "one_step.csv").open() as file:
        rows = [row[0] for row in csv.reader(file)]
    assert rows[1:] == ["model", name.replace("_", " "), "constant velocity", "ballistic"]
    named = [callback["class_path"] for callback in callbacks]
    assert (folder / RESULTS / "global_feature_permutation.md").exists() == (
        "callbacks.GlobalFeaturePermutation" in named
    )
    assert (folder / RESULTS / "ablation.png").exists()


def test_the_documented_ablations_of_other_blocks_run(
    run: Run, tmp_path: Path, sample: Path
) -> None:
    text = (ROOT / "docs" / "ablations.md").read_text()
    example = tmp_path / "example.yaml"
    example.write_text(text.partition("```yaml\n")[2].partition("```")[0])
    cells = "--data.init_args.voxel_size=0.5"  # few
    run("fit", TRAINER, PAPER, SAMPLE, example, more=(cells,))
    folder = tmp_path / "run"
    # Any test can look at the global feature.
    run("test", more=(f"--run={folder}", "--trainer.callbacks+=callbacks.GlobalFeaturePermutation"))
    rows = (folder / RESULTS / "one_step.md").read_text()
    assert all(name in rows for name in ("trapezoid", "full convolutions", "wide head"))
    assert (folder / RESULTS / "global_feature_permutation.md").exists()
    # The twins may be left out.
    alone = [f"--config={config}" for config in (TRAINER, PAPER, SAMPLE)]
    root = f"--data.init_args.root={sample}"
    logger = f"--trainer.logger.init_args.save_dir={tmp_path / 'alone'}"
    checkpoint = f"--ckpt_path={folder / 'checkpoints' / 'best.ckpt'}"
    main(["test", *alone, root, cells, logger, checkpoint])
    table = next((tmp_path / "alone").rglob("one_step.md")).read_text()
    assert table.count("\n") == 5


@pytest.mark.parametrize("ablation", ABLATIONS, ids=lambda p: p.stem)
def test_an_ablation_alone_is_put_upon_its_base(ablation: Path) -> None:
    base = [TRAINER, PAPER, CONFIGS / "data" / "dam_break_small.yaml"]
    found = with_base(["fit", "--config", str(ablation), f"--config={SAMPLE}", "--a=1"])
    paths = [Path(word.removeprefix("--config=")).resolve() for word in found[1:4]]
    assert paths == base
    assert found[4:] == ["--config", str(ablation), f"--config={SAMPLE}", "--a=1"]
    # After others it changes those.
    composed = ["fit", f"--config={TRAINER}", f"--config={ablation}"]
    assert with_base(composed) == composed


@pytest.mark.parametrize(
    ("base", "words"),
    [("x.yaml", "must be a list of files"), ("[x.yaml]", "its base .*x.yaml is missing")],
)
def test_a_base_that_is_not_there_is_refused(base: str, words: str, tmp_path: Path) -> None:
    overlay = tmp_path / "overlay.yaml"
    overlay.write_text(f"base: {base}\n")
    with pytest.raises(UserError, match=words):
        with_base(["fit", f"--config={overlay}"])


# The paper-size scenes' own samples (frames 300 on) are longer than the sample.
OVERLAYS: dict[str, tuple[str, ...]] = {
    "frame_range": ("--data.init_args.frame_range=[0,null]", "--data.init_args.sample_every=1"),
}


@pytest.mark.parametrize("data", sorted((CONFIGS / "data").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_data_config_trains(data: Path, run: Run) -> None:
    values = yaml.safe_load(data.read_text())["data"]["init_args"]
    more = OVERLAYS["frame_range"] if "frame_range" in values else ()
    # A cell as large as the paper's would leave the sample's box one cell wide; it may.
    run("fit", TRAINER, PAPER, data, more=more)


@pytest.mark.parametrize("size", ["", "_small"])
@pytest.mark.parametrize("scene", ["dam_break", "cuboid_basin", "drop_pool"])
def test_data_and_scene_configs_agree_on_table_1(scene: str, size: str) -> None:
    recipe = yaml.safe_load((CONFIGS / "scene" / f"{scene}{size}.yaml").read_text())["recipe"]
    data = yaml.safe_load((CONFIGS / "data" / f"{scene}{size}.yaml").read_text())["data"]
    domain = np.array(recipe["scene"]["init_args"]["domain"])
    cells = domain / data["init_args"]["voxel_size"]
    expected = [18, 12, 18] if scene == "dam_break" else [21, 21, 21]
    assert np.allclose(cells, expected)


@pytest.mark.parametrize("scene", sorted((CONFIGS / "scene").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_scene_config_draws_its_scenes(scene: Path, tmp_path: Path) -> None:
    parser = generate_parser()
    options = parser.instantiate(parser.parse_args([f"--config={scene}", f"--root={tmp_path}"]))
    recipe = options.recipe
    drawn = recipe.scene.sample(np.random.default_rng(0), recipe.particle_radius)
    for body in drawn.bodies:
        lower, upper = body.bounds()
        # In two dimensions the fluid lies in the plane z = 0.
        inside = (lower >= 0) & (upper <= np.array(drawn.domain))
        assert inside[: drawn.dimension].all()


# The paper's simulations take hours: the same scene of coarse particles takes a moment.
@pytest.mark.usefixtures("real_solver")
@pytest.mark.parametrize("scene", sorted((CONFIGS / "scene").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_scene_config_is_simulated(scene: Path, tmp_path: Path) -> None:
    parser = generate_parser()
    recipe = parser.instantiate(parser.parse_args([f"--config={scene}", "--root=x"])).recipe
    drawn = recipe.scene.sample(np.random.default_rng(0), recipe.particle_radius)
    radius = min(drawn.domain[: drawn.dimension]) / 24
    root = tmp_path / "data"
    changes = {"particle_radius": radius, "train": 1, "val": 0, "test": 0, "frames": 3}
    main(
        [
            *("generate", f"--config={scene}", f"--root={root}"),
            *(f"--recipe.{name}={value}" for name, value in changes.items()),
        ]
    )
    with h5py.File(root / "train.h5") as file:
        position, velocity = file["00000/position"][()], file["00000/velocity"][0]
        assert file.attrs["scene"] == type(recipe.scene).__name__
        assert file["00000/time"][-1] == pytest.approx(2 * recipe.frame_interval)
        described = json.loads(file["00000"].attrs["scene_parameters"])
    assert len(position) == 3
    # Nothing that was drawn is missing, such as the pool below a drop.
    for body in map(from_description, described):
        lower, upper = body.bounds()
        if isinstance(body, MovingBody):
            lower, upper = lower - radius, upper + radius
            volume = body.shape.volume()
        else:
            volume = np.prod(upper - lower) * (1.0 if isinstance(body, Block) else np.pi / 6)
        inside = ((position[0] > lower) & (position[0] < upper)).all(axis=1)
        assert inside.sum() * (2 * radius) ** 3 == pytest.approx(volume, rel=0.25)
    # Free fall or the start of a collapse, and no burst.
    elapsed = 2 * recipe.frame_interval
    moved = np.abs(position[2] - position[0] - elapsed * velocity).max()
    assert 0 < moved < 0.2 * radius + 20 * elapsed**2


def test_the_demo_trains_as_it_is_composed(run: Run, tmp_path: Path) -> None:
    run(
        "fit",
        *(TRAINER, CONFIGS / "model" / "corrected.yaml", SAMPLE, CONFIGS / "demo.yaml"),
        more=(
            *("--trainer.max_epochs=-1", "--trainer.max_steps=2", "--trainer.val_check_interval=2"),
            *OF_IISPH,
        ),
    )
    assert (tmp_path / "run" / "checkpoints" / "best.ckpt").exists()
    written = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())
    demo = yaml.safe_load((CONFIGS / "demo.yaml").read_text())
    assert written["trainer"]["gradient_clip_val"] == demo["trainer"]["gradient_clip_val"]
    prior = written["model"]["init_args"]["prior"]["init_args"]
    assert (prior["divergence_sweeps"], prior["sweeps"], prior["substeps"]) == (0, 4, 2)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_an_error_in_a_process_that_reads_ahead_is_one_sentence(
    run: Run, sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "damaged"
    shutil.copytree(sample, root)
    with h5py.File(root / "val.h5") as file:
        chunk = file["00000/velocity"].id.get_chunk_info(1)
    with (root / "val.h5").open("r+b") as content:
        content.seek(chunk.byte_offset)
        content.write(b"\xff" * chunk.size)
    more = (f"--data.init_args.root={root}", "--data.init_args.workers=1")
    with pytest.raises(SystemExit) as end:
        run("fit", TRAINER, PAPER, SAMPLE, more=more)
    assert end.value.code == 1
    said = capsys.readouterr().err
    words = said.strip().splitlines()[-1]
    assert words.startswith(f"fluidsnet: {root / 'val.h5'}: frame 1 of /00000 cannot be read")
    assert "Traceback" not in said


def test_the_rollout_file_holds_the_start_the_truths_error_and_each_step(
    run: Run, tmp_path: Path, sample: Path
) -> None:
    run("fit", TRAINER, PAPER, SAMPLE)
    folder = tmp_path / "run"
    # Ten steps more than the sample's 40, where there is no truth any more.
    run("predict", more=(f"--run={folder}", "--data.init_args.rollout_steps=50"))
    path = folder / RESULTS / "rollouts" / "00000.vtkhdf"
    figures = read_field_data(path)
    with h5py.File(sample / "test.h5") as file:
        truth = file["00000/position"][()].astype(np.float64)
        velocity = file["00000/velocity"][0].astype(np.float64)
    position, data = read_frame(path, 0)
    assert np.array_equal(position, truth[0].astype(np.float32))
    assert np.array_equal(data["velocity"], velocity.astype(np.float32))
    assert figures["time"] == pytest.approx(0.02 * np.arange(51))
    for step in (1, 7, 40):
        position, data = read_frame(path, step)
        distance = 1000 * np.linalg.norm(position - truth[step], axis=1)
        assert data["position_error"] == pytest.approx(distance, rel=1e-3, abs=1e-3)
        assert figures["position_error_mm"][step] == pytest.approx(distance.mean(), rel=1e-4)
        still = truth[0] + 0.02 * step * velocity - truth[step]
        expected = 1000 * np.linalg.norm(still, axis=1).mean()
        assert figures["constant_velocity_mm"][step] == pytest.approx(expected, rel=1e-4, abs=1e-3)
    assert np.isnan(figures["position_error_mm"][41:]).all()
    with (folder / RESULTS / "rollout_metrics_predict.csv").open() as file_:
        table = [row for row in csv.DictReader(file_) if row["predictor"] == "model"]
    assert [row["steps"] for row in table] == ["1", "2", "5", "10", "25", "40"]
    for row in table:
        step = int(row["steps"])
        assert float(row["position_error mm"]) == pytest.approx(figures["position_error_mm"][step])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", "--data.batch_sise=3"], "batch_sise"),
        (["fit", f"--config={TRAINER}", f"--config={PAPER}", f"--config={SAMPLE}",
          "--data.init_args.root=/nowhere"], "/nowhere holds none of train.h5"),
        (["fit", f"--config={TRAINER}", f"--config={PAPER}", f"--config={SAMPLE}",
          "--model.init_args.integrator=Displacement"], "needs a target that predicts"),
        (["fit", f"--config={CONFIGS / 'ablation' / 'target.yaml'}", f"--config={SAMPLE}",
          "--trainer.callbacks+=callbacks.Ablation", "--trainer.callbacks.block=targets",
          "--trainer.callbacks.name=other"], "there is no block 'targets'"),
        (["fit", f"--config={TRAINER}", f"--config={PAPER}", f"--config={SAMPLE}",
          "--trainer.callbacks+=callbacks.RolloutMetrics"], "give each a name of its own"),
        (["fit", f"--config={TRAINER}", f"--config={PAPER}", f"--config={SAMPLE}",
          "--trainer.logger=false"], "that has no logger"),
        (["fit", f"--config={TRAINER}", f"--config={PAPER}", f"--config={SAMPLE}",
          "--trainer.val_check_interval=500"], "val_check_interval"),
        (["fit", f"--config={TRAINER}", f"--config={PAPER}", f"--config={SAMPLE}",
          "--data.init_args.voxel_size=.inf"], "data.voxel_size is inf; it must be finite"),
        (["fit", f"--config={TRAINER}", f"--config={PAPER}", f"--config={SAMPLE}",
          "--trainer.logger=lightning.pytorch.loggers.MLFlowLogger"], "pip install"),
        (["test", "--run=/nowhere"], "/nowhere is not the folder of a run"),
        (["test", "--run=box_drop"], "ship with the package: box_drops, box_drops_40ms"),
        (["test", "--run"], "--run needs the folder"),
        (["fit", "--run=/nowhere"], "fit takes --config"),
        (["inspect", "/nowhere.h5"], "there is no such file"),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence_and_a_status(
    arguments: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(ROOT)
    with pytest.raises(SystemExit) as end:
        main([*arguments, *_elsewhere(arguments, tmp_path)])
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said


def test_a_config_that_is_no_text_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(SAMPLE.read_text(), encoding="utf-16")
    for arguments in (
        ["fit", f"--config={config}"],
        ["fit", "-c", str(config)],
        ["generate", "--config", str(config), "--root=x"],
        ["inspect", f"--model={config}", "--data=x.h5"],
    ):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        said = capsys.readouterr().err
        assert ended.value.code == 1
        if arguments[0] != "inspect":
            assert f"{config} is not UTF-8 text; save it as UTF-8" in said
    with pytest.raises(UserError, match="is not UTF-8 text"):
        has_weights(config)


def test_a_base_is_read_of_either_option(tmp_path: Path) -> None:
    overlay = tmp_path / "overlay.yaml"
    overlay.write_text(f"base: [{PAPER}]\n")
    for option in ("-c", "--config"):
        assert with_base(["fit", option, str(overlay)])[1] == f"--config={PAPER}"


def _elsewhere(arguments: list[str], folder: Path) -> list[str]:
    if "--trainer.logger=false" in arguments:
        return [f"--trainer.default_root_dir={folder}"]
    if arguments[0] == "fit" and any("configs" in argument for argument in arguments):
        return [f"--trainer.logger.init_args.save_dir={folder}"]
    return []


@pytest.mark.parametrize("option", ["--trainer.logger=false", "--trainer.fast_dev_run=true"])
def test_a_run_without_a_logger_leaves_the_working_folder_alone(
    option: str, sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    unlogged = ["--trainer.callbacks=[callbacks.OneStepTable]", "--trainer.max_steps=2", option]
    configs = [f"--config={config}" for config in (TRAINER, PAPER, SAMPLE)]
    main(["fit", *configs, f"--data.init_args.root={sample}", *unlogged])
    folders = [] if "fast_dev_run" in option else ["runs"]
    assert [path.name for path in tmp_path.iterdir()] == folders
    if folders:
        assert (tmp_path / "runs" / "unlogged" / "config.yaml").exists()
        assert list((tmp_path / "runs" / "unlogged").rglob("*.ckpt"))


def test_the_last_weights_are_kept_beside_the_best_and_trained_on(run: Run, tmp_path: Path) -> None:
    # The first weights are the worst by far; they are kept as the best are.
    config = yaml.safe_load(TRAINER.read_text())
    config["trainer"]["callbacks"][0]["init_args"]["mode"] = "min"
    upside_down = tmp_path / "trainer.yaml"
    upside_down.write_text(yaml.safe_dump(config))
    more = ("--model.init_args.optimizer.init_args.lr=0.3", "--trainer.val_check_interval=2",
            "--trainer.limit_train_batches=6")  # fmt: skip
    run("fit", upside_down, PAPER, SAMPLE, more=more)
    assert kept_steps(tmp_path) == {"best.ckpt": 2, "last.ckpt": 6}
    last = tmp_path / "run" / "checkpoints" / "last.ckpt"
    kept = tmp_path / "run" / "config.yaml"
    main(["fit", f"--config={kept}", f"--ckpt_path={last}", "--trainer.max_steps=8",
          "--trainer.max_epochs=-1"])  # fmt: skip
    assert kept_steps(tmp_path) == {"best.ckpt": 2, "last.ckpt": 8}
    # Anew in the same folder.
    run("fit", TRAINER, PAPER, SAMPLE, more=("--trainer.limit_train_batches=3",))
    assert kept_steps(tmp_path) == {"best.ckpt": 3, "last.ckpt": 3}


def kept_steps(folder: Path) -> dict[str, int]:
    """Of each checkpoint, how many steps it was trained."""
    paths = (folder / "run" / "checkpoints").iterdir()
    return {path.name: torch.load(path, weights_only=False)["global_step"] for path in paths}


def test_the_metrics_of_a_csv_logger_are_kept(run: Run, tmp_path: Path) -> None:
    run("fit", TRAINER, PAPER, SAMPLE, more=("--trainer.logger=CSVLogger",))
    trained = (tmp_path / "run" / "metrics.csv").read_text()
    assert "val/skill" in trained
    for number in (1, 2):
        main(["validate", f"--run={tmp_path / 'run'}", "--trainer.enable_progress_bar=false"])
        assert (tmp_path / "run" / "metrics_1.csv").read_text() == trained
        assert (tmp_path / "run" / f"metrics_{number}.csv").exists()


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--help"])
    assert capsys.readouterr().out == USAGE
    with pytest.raises(SystemExit) as end:
        main(["nonsense"])
    assert end.value.code == 2
    error = capsys.readouterr().err
    for word in ("generate", "inspect", "fit", "validate", "test", "predict", "speed", "report"):
        assert f"\n  {word} " in USAGE
        assert word in error


def test_the_installed_program_says_its_errors_on_stderr() -> None:
    program = [sys.executable, "-m", "fluidsnet.main"]
    ended = subprocess.run(
        [*program, "inspect", str(ROOT / "pyproject.toml")],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert ended.returncode == 1
    assert ended.stdout == ""
    assert ended.stderr.count("\n") == 1
    assert "not a whole HDF5 file" in ended.stderr


def test_a_reader_that_ends_ends_the_command_quietly(sample: Path) -> None:
    command = f"{sys.executable} -m fluidsnet.main inspect {sample / 'test.h5'} | head -1"
    ended = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert ended.stdout.count("\n") == 1 and "Traceback" not in ended.stderr


@pytest.mark.parametrize("precision", ["64-true", "bf16-true", "16-true"])
def test_a_precision_that_positions_do_not_allow_is_refused(
    precision: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(
            [
                "fit",
                *(f"--config={CONFIGS / it}" for it in ("model/paper.yaml", "data/sample.yaml")),
                *("--trainer.max_steps=1", f"--trainer.precision={precision}"),
            ]
        )
    assert f"trainer.precision is {precision}; use 32-true, bf16" in capsys.readouterr().err


def test_the_last_checkpoint_of_another_folder_is_not_taken_for_a_fresh_start(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        run("fit", TRAINER, PAPER, SAMPLE, more=("--ckpt_path=last",))
    message = capsys.readouterr().err
    assert "--ckpt_path last: " in message and "last.ckpt is missing; name the file" in message
    assert not list(tmp_path.rglob("*.ckpt"))


def test_a_resumed_schedule_stays_where_it_ended(run: Run, tmp_path: Path) -> None:
    cosine = "torch.optim.lr_scheduler.CosineAnnealingLR"
    schedule = f"--model.init_args.schedule={{class_path: {cosine}, init_args: {{eta_min: 1e-5}}}}"
    limits = ("--trainer.limit_train_batches=4", schedule)
    run("fit", TRAINER, PAPER, SAMPLE, more=limits)
    folder = tmp_path / "run"

    def rate() -> float:
        saved = torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)
        found: float = saved["lr_schedulers"][0]["_last_lr"][0]
        return found

    assert rate() == pytest.approx(1e-5)
    main(
        [
            *("fit", f"--config={folder / 'config.yaml'}", "--ckpt_path=last"),
            *("--trainer.max_steps=12", "--trainer.max_epochs=-1"),
            "--trainer.enable_progress_bar=false",
        ]
    )
    assert kept_steps(tmp_path)["last.ckpt"] == 12
    assert rate() == pytest.approx(1e-5)


@pytest.mark.parametrize("stretched", [False, True])
def test_a_resumed_schedule_is_stretched_on_purpose(
    stretched: bool, run: Run, tmp_path: Path
) -> None:
    run("fit", TRAINER, PAPER, SAMPLE, more=("--trainer.limit_train_batches=4",))
    folder = tmp_path / "run"
    main(
        [
            *("fit", f"--config={folder / 'config.yaml'}", "--ckpt_path=last"),
            *("--trainer.max_steps=12", "--trainer.max_epochs=-1", "--trainer.log_every_n_steps=1"),
            *("--trainer.enable_progress_bar=false", "--trainer.limit_val_batches=0"),
            f"--model.init_args.stretch_schedule={stretched}",
        ]
    )
    events = EventAccumulator(str(folder))
    events.Reload()
    rates = [event.value for event in events.Scalars("train/learning_rate")][-8:]
    # The first step has the rate of the checkpoint; full until half of the steps are done.
    expected = [0.00015, 0.003 if stretched else 0.00015, *[0.00015] * 6]
    assert rates == pytest.approx(expected)


def killed(
    arguments: list[str], number: signal.Signals, folder: Path, sign: str, size: int
) -> tuple[int | None, str]:
    """Run a command, send it a signal once a file is large; return its status and output."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    output = folder.parent / "output.txt"
    with started(arguments, output) as process:
        assert process.pid is not None
        deadline = time.monotonic() + 120
        while process.is_alive():
            if any(path.stat().st_size > size for path in folder.glob(sign)):
                break
            assert time.monotonic() < deadline
            time.sleep(0.05)
        with suppress(ProcessLookupError):
            os.kill(process.pid, number)
        process.join(120)
        return process.exitcode, output.read_text()


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["ctrl-c", "term"]
)
def test_a_run_that_is_interrupted_before_its_first_validation_keeps_its_weights(
    sample: Path, tmp_path: Path, number: signal.Signals, status: int
) -> None:
    arguments = [
        "fit",
        *(f"--config={config}" for config in (TRAINER, PAPER, SAMPLE)),
        f"--data.init_args.root={sample}",
        *("--data.init_args.workers=0", "--trainer.max_epochs=-1", "--trainer.max_steps=1000000"),
        *("--trainer.check_val_every_n_epoch=null", "--trainer.val_check_interval=1000000"),
        *("--trainer.logger.init_args.name=run", "--trainer.logger.init_args.version="),
        *("--trainer.enable_progress_bar=false", "--trainer.log_every_n_steps=1"),
        f"--trainer.logger.init_args.save_dir={tmp_path}",
    ]
    found, errors = killed(arguments, number, tmp_path / "run", "events.*", 5_000)
    assert found == status, errors
    assert "Traceback" not in errors
    saved = torch.load(tmp_path / "run" / "checkpoints" / "last.ckpt", weights_only=True)
    assert saved["global_step"] > 0


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["ctrl-c", "term"]
)
def test_a_rollout_that_is_interrupted_keeps_its_steps(
    sample: Path, tmp_path: Path, number: signal.Signals, status: int
) -> None:
    arguments = [
        "predict",
        *(f"--config={CONFIGS / 'model' / 'prior.yaml'}", f"--config={TRAINER}"),
        f"--config={SAMPLE}",
        *(f"--data.init_args.root={sample}", "--data.init_args.rollout_steps=1000000"),
        "--trainer.callbacks=[callbacks.TrajectoryWriter]",
        *("--trainer.logger.init_args.name=run", "--trainer.logger.init_args.version="),
        f"--trainer.logger.init_args.save_dir={tmp_path}",
    ]
    folder = tmp_path / "run" / RESULTS / "rollouts"
    found, errors = killed(arguments, number, folder, "*.vtkhdf.tmp", 400_000)
    assert found == status, errors
    assert "Traceback" not in errors
    (path,) = folder.glob("*.vtkhdf")
    assert len(read_field_data(path)["time"]) > 1


def test_ctrl_c_in_a_callback_of_the_garbage_collector_is_not_lost(default_signals: None) -> None:
    code = """
import signal, sys, time, weakref
from fluidsnet.main import main

sys.argv = ["fluidsnet", "--help"]
main()
counted = type("Counted", (), {})()
reference = weakref.ref(counted, lambda _: signal.raise_signal(signal.SIGINT))
try:
    del counted
    time.sleep(20)
    print("lost")
except KeyboardInterrupt:
    print("came")
"""
    command = [sys.executable, "-c", code]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert ended.stdout.endswith("came\n")
    assert not ended.stderr


def test_ctrl_c_while_a_kernel_is_called_is_ctrl_c(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def called(arguments: list[str]) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interrupt:
            raise SystemError("CPUDispatcher(…) returned a result with an error") from interrupt

    monkeypatch.setattr("fluidsnet.doctor.doctor_command", called)
    with pytest.raises(SystemExit, match="130"):
        main(["doctor"])
    assert capsys.readouterr().err == "fluidsnet: interrupted.\n"
