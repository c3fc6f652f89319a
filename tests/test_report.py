"""`fluidsnet report`: a page and tables from real runs on the sample."""

from __future__ import annotations

import csv
import hashlib
import json
import re
import shutil
from base64 import b64decode
from collections.abc import Sequence
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import h5py
import lightning
import pandas as pd
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.tensorboard import SummaryWriter

from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.report.events import read_event_file, read_history
from fluidsnet.report.run import flat, names, read_runs
from fluidsnet.report.settings import changed, differing, shipped
from fluidsnet.report.tables import read_table, shown, side_by_side
from fluidsnet.report.training import Line, draw
from fluidsnet.reporting.results import DATA_FILE, RESULTS, results_folders
from fluidsnet.reporting.table import write_table

ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"
SAMPLE = ROOT / "tests" / "data" / "dam_break"

# It logs to the stderr that there is when it is loaded, which must not be one test's own.
assert lightning

VOID = {"meta", "img", "link", "br", "hr", "input"}


@dataclass
class Page(HTMLParser):
    """What a page is made of; opening and closing tags must match."""

    text: str
    open: list[str] = field(default_factory=list)
    tags: list[tuple[str, dict[str, str | None]]] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self.feed(self.text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data.strip())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def rows(path: Path) -> list[list[str]]:
    with path.open(newline="") as file:
        return list(csv.reader(file))


ROLLS_OUT = """
trainer:
  callbacks:
    - class_path: lightning.pytorch.callbacks.ModelCheckpoint
      init_args: {filename: last, enable_version_counter: false}
    - class_path: callbacks.OneStepTable
    - class_path: callbacks.RolloutMetrics
      init_args: {steps: 3, every_n_validations: 1}
"""


def fit(folder: Path, name: str, *more: str, configs: Sequence[str] = ()) -> None:
    """Trains four steps on the sample and logs each, unless told otherwise."""
    base = ("trainer.yaml", "model/paper.yaml", "data/sample.yaml")
    main(
        [
            "fit", *(f"--config={CONFIGS / config}" for config in (*base, *configs)),
            f"--data.init_args.root={SAMPLE}",
            "--trainer.max_steps=4", "--trainer.log_every_n_steps=1",
            "--trainer.val_check_interval=2", "--trainer.limit_val_batches=2",
            "--trainer.enable_progress_bar=false", "--trainer.accelerator=cpu",
            f"--trainer.logger.init_args.save_dir={folder}",
            f"--trainer.logger.init_args.name={name}", "--trainer.logger.init_args.version=",
            *more,
        ]
    )  # fmt: skip


def results(run: Path) -> Path:
    """The only results folder of a run."""
    (folder,) = results_folders(run)
    return folder


def report(*runs: Path, output: Path) -> Page:
    main(["report", *map(str, runs), f"--output={output}"])
    return Page((output / "report.html").read_text())


def identity(root: Path) -> dict[str, Any]:
    digest = hashlib.sha256((root / "test.h5").read_bytes()).hexdigest()
    return {
        "root": str(root), "file": "test.h5", "sha256": digest, "stride": 1, "time_step": 0.02,
        "frame_range": [0, None], "sample_every": 1, "simulations": 1, "frames": 41,
    }  # fmt: skip


def into_results_folder(run: Path) -> None:
    """Moves tables and pictures from a run's own folder to where they belong."""
    if (run / RESULTS).exists():
        return
    folder = run / RESULTS / SAMPLE.name
    folder.mkdir(parents=True)
    (folder / DATA_FILE).write_text(json.dumps(identity(SAMPLE)))
    for ending in ("csv", "md", "png"):
        for path in run.glob(f"*.{ending}"):
            path.rename(folder / path.name)
    if run.name == "one":
        for ending in ("csv", "md"):
            (folder / f"rollout.{ending}").unlink()
            path = folder / f"rollout_metrics.{ending}"
            shutil.copy(path, path.with_stem("rollout_metrics_predict"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the run `one`, tested and rolled out, and `two`, which has a twin.

    Only `two` rolls out while it trains.
    """
    folder = tmp_path_factory.mktemp("runs")
    rolls_out = folder / "rolls_out.yaml"
    rolls_out.write_text(ROLLS_OUT)
    rate = "--model.init_args.optimizer.init_args.lr={}"
    fit(folder, "one", rate.format(0.003))
    fit(folder, "two", rate.format(0.001), configs=[str(rolls_out), "ablation/target.yaml"])
    for name in ("one", "two"):
        main(["test", f"--run={folder / name}", "--trainer.limit_test_batches=2"])
    main(["predict", f"--run={folder / 'one'}", "--data.init_args.rollout_steps=3"])
    for name in ("one", "two"):
        into_results_folder(folder / name)
    return folder


@pytest.fixture
def one(runs: Path, tmp_path: Path) -> Path:
    """A copy of the run `one`, to be damaged."""
    return Path(shutil.copytree(runs / "one", tmp_path / "one"))


def test_the_page_is_whole_and_asks_for_nothing(runs: Path, tmp_path: Path) -> None:
    page = report(runs / "one", output=tmp_path)
    assert page.all("html") == [{"lang": "en"}]
    assert "FluidsNet: one" in page.words
    assert len(page.all("h1")) == 1
    addresses = [
        value
        for _, attributes in page.tags
        for name, value in attributes.items()
        if name in ("src", "href", "xlink:href", "srcset", "action", "data") and value
    ]
    assert all(address.startswith(("#", "data:image/png;base64,")) for address in addresses)
    assert "@import" not in page.text and not re.search(r"url\((?!#)", page.text)
    assert not page.all("script") and not page.all("link")
    names = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(names) == len(set(names))
    assert {address[1:] for address in addresses if address.startswith("#")} <= set(names)
    assert "(prefers-color-scheme: dark)" in page.text


def test_pictures_and_curves_are_within_it_and_have_words(runs: Path, tmp_path: Path) -> None:
    page = report(runs / "one", output=tmp_path)
    pictures = {path.read_bytes() for path in results(runs / "one").glob("*.png")}
    assert len(pictures) >= 2
    images = page.all("img")
    assert {b64decode((image["src"] or "").partition(",")[2]) for image in images} == pictures
    assert all(image["alt"] for image in images)
    curves = [part for part in page.all("div") if part.get("role") == "img"]
    # Loss, skill, learning rate.
    assert len(curves) == len(page.all("svg")) == 3
    assert all("over the training steps" in (curve["aria-label"] or "") for curve in curves)
    assert all(cell["scope"] in ("row", "col") for cell in page.all("th"))
    assert len(page.all("caption")) == len(page.all("table"))


def test_the_picture_of_an_ablation_is_shown(runs: Path, tmp_path: Path) -> None:
    page = report(runs / "two", output=tmp_path)
    pictures = {image["alt"]: image["src"] or "" for image in page.all("img")}
    words = "two: The truth and every model against time; the lighter a particle, the faster"
    shown = b64decode(pictures[words].partition(",")[2])
    assert shown == (results(runs / "two") / "ablation.png").read_bytes()


@pytest.mark.parametrize("table", ["one_step", "rollout_metrics", "rollout_metrics_predict"])
def test_tables_are_the_runs_own(table: str, runs: Path, tmp_path: Path) -> None:
    page = report(runs / "one", output=tmp_path)
    own, copied = (rows(folder / f"{table}.csv") for folder in (results(runs / "one"), tmp_path))
    assert copied[0] == own[0] and len(copied) == len(own)
    markdown = (tmp_path / "report.md").read_text()
    for mine, theirs in zip(copied[1:], own[1:], strict=True):
        for one, other in zip(mine, theirs, strict=True):
            try:
                assert float(one) == float(other)
                assert shown(float(other)) in page.words and shown(float(other)) in markdown
            except ValueError:
                assert one == other
                assert one in page.words and one in markdown


def test_the_curves_are_those_of_the_training_alone(one: Path, tmp_path: Path) -> None:
    history = read_history(one)
    assert [step for step, _ in history.curves["train/loss"]] == [0, 1, 2, 3]
    assert [step for step, _ in history.curves["val/skill"]] == [1, 3]
    # A later validation logs the same tags at step 0.
    with SummaryWriter(one) as writer:
        writer.add_scalar("val/skill", 0.5, 0)
    assert read_history(one).curves == history.curves
    # A training that is resumed logs from where its checkpoint was.
    with SummaryWriter(one, filename_suffix=".resumed") as writer:
        writer.add_scalar("train/loss", 7.0, 2)
        writer.add_scalar("train/loss", float("nan"), 3)
    curves = read_history(one).curves
    assert [step for step, _ in curves["train/loss"]] == [0, 1, 2, 3]
    assert curves["train/loss"][2] == (2, 7.0)
    assert curves["val/skill"] == history.curves["val/skill"][:1]
    assert "one: train/loss is not finite at step 3" in report(one, output=tmp_path / "r").text


def test_a_training_that_is_repeated_leaves_nothing_of_the_one_before(one: Path) -> None:
    first = read_history(one)
    assert [step for step, _ in first.curves["train/loss"]] == [0, 1, 2, 3]
    # Its first loss comes after its first validation.
    more = ["--trainer.max_steps=3", "--trainer.log_every_n_steps=3"]
    fit(one.parent, "one", *more, "--trainer.val_check_interval=1")
    curves = read_history(one).curves
    assert [step for step, _ in curves["train/loss"]] == [2]
    assert [step for step, _ in curves["val/skill"]] == [0, 1, 2]
    assert max(curve[-1][0] for curve in curves.values()) == 2


def test_a_training_that_is_resumed_keeps_what_went_before(one: Path) -> None:
    first = read_history(one).curves
    checkpoint = one / "checkpoints" / "last.ckpt"
    begin = torch.load(checkpoint, weights_only=False)["global_step"]
    assert begin > 0
    # At whatever step it is resumed, Lightning logs this at step 0.
    logged = "--trainer.logger.init_args.default_hp_metric=true"
    fit(one.parent, "one", "--trainer.max_steps=6", f"--ckpt_path={checkpoint}", logged)
    curves = read_history(one).curves
    assert curves["hp_metric"] == ((0, -1.0),)
    assert [step for step, _ in curves["train/loss"]] == list(range(6))
    for tag in ("train/loss", "val/skill"):
        assert [point for point in curves[tag] if point[0] < begin] == [
            point for point in first[tag] if point[0] < begin
        ]


def test_a_training_shorter_than_the_interval_of_its_losses_is_one(tmp_path: Path) -> None:
    fit(tmp_path, "short", "--trainer.log_every_n_steps=5")
    curves = read_history(tmp_path / "short").curves
    assert "train/loss" not in curves
    assert [step for step, _ in curves["val/skill"]] == [1, 3]
    page = report(tmp_path / "short", output=tmp_path / "report")
    assert "short has no train/loss: fluidsnet fit logs the loss after every" in page.text
    # Skill and the loss of validation.
    assert len(page.all("svg")) == 2


def test_values_are_those_that_tensorboard_reads(runs: Path) -> None:
    for path in runs.glob("*/events*"):
        events = EventAccumulator(str(path), size_guidance={"scalars": 0})
        events.Reload()
        scalars, flaw = read_event_file(path)
        assert flaw == ""
        assert list(scalars) == events.Tags()["scalars"]
        for tag, values in scalars.items():
            assert values == events.Scalars(tag)


def test_a_byte_that_is_not_as_written_is_found_wherever_it_is(one: Path) -> None:
    whole = read_history(one)
    path = min(one.glob("events*"))
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    found = {}
    # In the first record's length, its checksum, the event, its checksum, in others, at the end.
    for place in (0, 8, 12, 12 + size, *range(size + 16, len(data), len(data) // 20), -1):
        damaged = bytearray(data)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        history = read_history(one)
        (sentence,) = history.unread
        assert sentence.startswith(f"{path.name} is damaged")
        for tag, curve in history.curves.items():
            assert curve == whole.curves[tag][: len(curve)]
        last = max((curve[-1][0] for curve in history.curves.values()), default=None)
        if last is not None:
            assert sentence.endswith(f": what followed a value at step {last} is missing.")
        found[place] = history
    assert found[0].unread == [f"{path.name} is damaged: no value precedes that."]
    assert found[0].curves == {}
    assert found[-1].curves == whole.curves


@pytest.mark.parametrize("left", [1, 8, 11, 12, 20])
def test_a_file_that_ends_within_a_record_is_told_from_a_damaged_one(left: int, one: Path) -> None:
    path = min(one.glob("events*"))
    path.write_bytes(path.read_bytes()[:left])
    flaw = "ends within a record, as after its process was killed: no value precedes that."
    assert read_event_file(path) == ({}, f"{path.name} {flaw}")


def test_settings_are_compared_with_what_is_shipped() -> None:
    base = shipped()
    assert base["model.target"] == "VelocityTarget"
    assert changed({"a": base}, base).empty
    run = flat(
        {
            "seed_everything": 0,
            "model": {
                "class_path": "fluidsnet.FluidsNet",
                "init_args": {
                    "local": {
                        "class_path": "fluidsnet.features.NeighborMean",
                        "init_args": {"width": 11},
                    },
                    "target": {"class_path": "fluidsnet.target.DisplacementTarget"},
                    "walls": {"class_path": "nowhere.Walls", "init_args": {"a": 1}},
                    "head": [32, 16, 8],
                },
            },
            "trainer": {"callbacks": [{"class_path": "callbacks.OneStepTable"}], "max_epochs": 3},
        }
    )  # fmt: skip
    found = {row[0]: tuple(row[1:]) for row in changed({"a": run}, base).to_numpy().tolist()}
    assert found["model.local.width"] == ("11", "9")
    assert found["model.target"] == ("DisplacementTarget", "VelocityTarget")
    assert found["model.walls"] == ("Walls", "OpenWalls")
    # A class that is gone has no defaults.
    assert found["model.walls.a"] == ("1", "–")
    assert found["trainer.callbacks.RolloutMetrics"] == ("–", "RolloutMetrics")
    assert found["trainer.max_epochs"] == ("3", "-1")
    assert "model.head" not in found and "trainer.callbacks.OneStepTable" not in found
    assert differing({"a": run, "b": run}).empty


def test_a_run_says_what_it_changed_and_what_its_data_are(runs: Path, tmp_path: Path) -> None:
    page = report(runs / "one", output=tmp_path)
    settings = {row[0]: row[1:] for row in rows(tmp_path / "settings.csv")}
    assert settings["trainer.max_steps"] == ["4", "2400"]
    assert not any(name.startswith("model") for name in settings)
    assert (runs / "one" / "config.yaml").read_text().strip() in page.words
    data = rows(tmp_path / "data.csv")
    assert [row[:2] for row in data] == [
        ["split", "simulations"], ["train", "3"], ["val", "1"], ["test", "1"],
    ]  # fmt: skip
    assert any("a step every 20 ms" in words for words in page.words)


def test_several_runs_stand_side_by_side(runs: Path, tmp_path: Path) -> None:
    page = report(runs / "one", runs / "two", output=tmp_path)
    table = rows(tmp_path / "one_step.csv")
    assert table[0][:3] == ["one step ahead", "skill, one", "skill, two"]
    mine = {row[0]: dict(zip(table[0], row, strict=True)) for row in table[1:]}
    assert list(mine) == ["model", "acceleration", "constant velocity", "ballistic"]
    for name in ("one", "two"):
        for row in rows(results(runs / name) / "one_step.csv")[1:]:
            assert float(mine[row[0]][f"skill, {name}"]) == float(row[1])
    assert mine["acceleration"]["skill, one"] == "–"
    assert not any("other frames" in words for words in page.words)
    settings = {row[0]: row[1:] for row in rows(tmp_path / "settings_that_differ.csv")}
    assert settings["setting"] == ["one", "two"]
    assert settings["model.optimizer.lr"] == ["0.003", "0.001"]
    assert settings["trainer.callbacks.Ablation"] == ["–", "Ablation"]
    assert "one: train/loss" in page.words and "two: train/loss" in page.words
    assert "two has no rollout_metrics_predict.csv" in page.text
    ablation = {row[0]: row[1:] for row in rows(tmp_path / "ablation_two.csv")}
    assert ablation["two"] == ["model", "acceleration"]
    curves = read_history(runs / "two").curves
    for column, who in enumerate(ablation["two"]):
        assert float(ablation["skill, last"][column]) == curves[f"ablation/skill/{who}"][-1][1]
        assert float(ablation["cost/step_seconds"][column]) > 0
    # One of the many figures of the rollouts, after the most steps.
    rolled = [figure for figure in ablation if "rollout" in figure]
    assert rolled == ["rollout/position_error_mm/3, last"]
    for column, who in enumerate(ablation["two"]):
        last = curves[f"ablation_rollout/position_error_mm/3/{who}"][-1][1]
        assert float(ablation[rolled[0]][column]) == last
    assert "rollout/position_error_mm/3, two and its twins" in page.text
    assert "two has the same data as one." in page.words


def test_runs_on_other_frames_are_not_compared(runs: Path, one: Path, tmp_path: Path) -> None:
    path = results(one) / "one_step.csv"
    path.write_text(path.read_text().replace("constant velocity,0.0,0", "constant velocity,0.0,1"))
    page = report(runs / "one", one, output=tmp_path / "report")
    assert any("must not be set beside each other" in words for words in page.words)


def test_what_is_missing_is_said_in_a_line(one: Path, tmp_path: Path) -> None:
    shutil.rmtree(one / RESULTS)
    for path in one.iterdir():
        if path.is_file() and path.name != "config.yaml":
            path.unlink()
    page = report(one, output=tmp_path / "report")
    missing = sum(part.get("class") == "missing" for part in page.all("p"))
    # A glance, one step, rollouts, metrics, pictures, training, ablations.
    assert missing == 7
    assert "one has no curves of a training" in page.text
    assert not page.all("svg") and not page.all("img")
    for words in ("one has no one_step.csv: fluidsnet test", "one has no pictures"):
        assert words in page.text


def test_files_that_are_damaged_are_named(one: Path, tmp_path: Path) -> None:
    (one / "config.yaml").write_text("model: [")
    (results(one) / "one_step.csv").write_text("a,b\n1\n")
    (results(one) / "rollout_metrics.csv").write_bytes(b"\xff\xfe\x00")
    event = min(one.glob("events*"))
    event.write_bytes(event.read_bytes()[:-20])
    (one / "events.out.tfevents.0").write_bytes(b"nonsense" * 100)
    (one / "events.out.tfevents.1").mkdir()
    (results(one) / "rollout.png").write_bytes(b"")
    page = report(one, output=tmp_path / "report")
    for name in ("config.yaml", "one_step.csv", "rollout_metrics.csv", "rollout.png"):
        assert f"{name} cannot be read" in page.text
    for sentence in (
        "events.out.tfevents.0 is damaged: no value precedes that.",
        "events.out.tfevents.1 cannot be read: Is a directory.",
        f"{event.name} ends within a record, as after its process was killed: what followed a "
        "value at step 3 is missing.",
    ):
        assert f"one: {sentence}" in page.words
    # What was written before the damage is there.
    assert "train/loss" in page.words


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it is empty"),
        ("\n\n", "it is empty"),
        *((text, "it is not a header and rows") for text in ("a,b\n", "a,b\n1\n", "a\n1,2\n")),
        ("a,b\n1,2\n1,2,3\n", "Expected 2 fields in line 3, saw 3"),
    ],
)
def test_a_table_without_rows_is_none(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(ValueError, match=words):
        read_table(tmp_path / "table.csv")


def test_a_name_is_text_and_not_markup(one: Path, tmp_path: Path) -> None:
    other = one.rename(one.with_name("<b>$a|b$"))
    page = report(other, output=tmp_path / "report")
    assert not page.all("b")
    assert "FluidsNet: <b>$a|b$" in page.words


@pytest.mark.parametrize(
    ("make", "words"),
    [
        ((), "there is no such folder"),
        (("run/notes.txt",), "it holds no config.yaml"),
        (("run/version_0/config.yaml",), "such as"),
    ],
)
def test_a_folder_that_is_no_run_is_one_sentence(
    make: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in make:
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    with pytest.raises(SystemExit) as end:
        main(["report", str(tmp_path / "run")])
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert f"{tmp_path / 'run'} is not the folder of a run" in said
    assert words in said
    assert said.count("\n") == 1


def test_a_report_does_not_replace_a_runs_own_files(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["report", str(runs / "one"), f"--output={runs / 'two'}"])
    assert end.value.code == 1
    assert "choose another --output" in capsys.readouterr().err
    with pytest.raises(UserError, match="named twice"):
        read_runs([runs / "one", runs / "two" / ".." / "one"])


@pytest.mark.parametrize("taken", ["report", "report/report.md/file"])
def test_a_report_that_cannot_be_written_is_one_sentence(
    taken: str, one: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / taken).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / taken).touch()
    below = "/below" if taken == "report" else ""
    capsys.readouterr()
    with pytest.raises(SystemExit) as end:
        main(["report", str(one), f"--output={tmp_path / 'report'}{below}"])
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert "cannot be written" in said and "choose another folder" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("where", "first", "other", "printed"),
    [
        ("", "one", "two", "report"),
        ("one", ".", "../two", "{}/report"),
        ("one/checkpoints", "..", "../../two", "{}/report"),
    ],
)
def test_a_report_of_several_lies_beside_the_first(
    where: str,
    first: str,
    other: str,
    printed: str,
    runs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    there = shutil.copytree(runs, tmp_path / "runs")
    monkeypatch.chdir(there / where)
    main(["report", first, other])
    assert (there / "report" / "report.html").is_file()
    assert not (there / "one" / "report").exists()
    page = capsys.readouterr().out.splitlines()[-2]
    assert page == f"{printed.format(there)}/report.html"


def test_further_rollouts_stand_as_the_first_do(runs: Path, one: Path, tmp_path: Path) -> None:
    """Those of a `RolloutMetrics` with a name."""
    folder = results(one)
    for ending in ("csv", "md", "png"):
        first, further = (f"rollout_metrics{which}.{ending}" for which in ("", "_in_motion"))
        shutil.copy(folder / first, folder / further)
    with (folder / "rollout_metrics_in_motion.md").open("a") as file:
        file.write("\nThe model's rollout of /simulation_0 came to rest.\n")
    (folder / "rollout_metrics_early.csv").write_text("")
    page = report(one, output=tmp_path / "single")
    assert "The model's rollout of /simulation_0 came to rest." in page.words
    early = (folder / "rollout_metrics_early.csv").relative_to(one)
    assert f"one: {early} cannot be read: it is empty." in page.words
    after = f"after_{read_table(folder / 'rollout_metrics.csv')['steps'].iloc[-1]}"
    for name in ("", f"_{after}"):
        own, other = (
            rows(tmp_path / "single" / f"rollout_metrics{which}{name}.csv")
            for which in ("", "_in_motion")
        )
        assert other == own
    words = f"Every metric of the test's rollouts{{}} {after.replace('_', ' ')} steps"
    for which in ("", " (in motion)"):
        assert words.format(which) in page.words
        assert f"Every metric of one{which} after each number of steps" in page.words
        caption = f"one: Errors and energies of the test's rollouts{which} against time"
        assert caption in [image["alt"] for image in page.all("img")]
    # Beside another run that has none, which is no fault.
    page = report(runs / "two", one, output=tmp_path / "several")
    assert (tmp_path / "several" / f"rollout_metrics_in_motion_{after}.csv").is_file()
    assert (tmp_path / "several" / "rollout_metrics_in_motion_one.csv").is_file()
    assert words.format(" (in motion) of one") in page.words
    assert "two has no rollout_metrics_in_motion" not in page.text
    # Beside one that has them, a column each.
    other_run = Path(shutil.copytree(one, one.with_name("other")))
    table = results(other_run) / "rollout_metrics_in_motion.csv"
    table.write_text(table.read_text().replace("model,", "net,"))
    report(one, other_run, output=tmp_path / "both")
    header = rows(tmp_path / "both" / f"rollout_metrics_in_motion_{after}.csv")[0]
    assert {"model, one", "net, other"} <= set(header)


def test_results_on_each_data_set_stand_apart(runs: Path, one: Path, tmp_path: Path) -> None:
    wave = Path(shutil.copytree(SAMPLE, tmp_path / "wave"))
    with h5py.File(wave / "test.h5", "r+") as file:
        file.attrs["viscosity"] = 0.5
    folder = Path(shutil.copytree(results(one), one / RESULTS / "wave"))
    (folder / DATA_FILE).write_text(json.dumps(identity(wave)))
    header, *cells = rows(folder / "one_step.csv")
    write_table(folder / "one_step", header, [[row[0], 7.5, *row[2:]] for row in cells])
    digests = [identity(root)["sha256"][:12] for root in (SAMPLE, wave)]
    assert digests[0] != digests[1]

    page = report(one, output=tmp_path / "single")
    for section in ("One step ahead", "Rollouts", "Pictures"):
        titles = [f"{section}: dam_break", f"{section}: wave"]
        # Links first, then headings.
        assert [it for it in page.words if it.startswith(f"{section}: ")] == 2 * titles
    for root, digest in zip((SAMPLE, wave), digests, strict=True):
        measured = f"Measured on {root / 'test.h5'} (sha256 {digest}): "
        settings = "stride 1, simulations 1, frames 41, time step 20 ms."
        assert measured + settings in page.words
        assert measured + settings in (tmp_path / "single" / "report.md").read_text()
    assert f"one was trained on other data: {SAMPLE}." in page.words
    assert rows(tmp_path / "single" / "one_step_dam_break.csv") == rows(
        one / RESULTS / "dam_break" / "one_step.csv"
    )
    assert rows(tmp_path / "single" / "one_step_wave.csv") == rows(folder / "one_step.csv")
    glance = {row[0]: row[1] for row in rows(tmp_path / "single" / "glance.csv")}
    assert glance["test: skill, wave"] == "7.5" != glance["test: skill, dam_break"]

    # Beside a run with results on the first data only, these alone are set side by side.
    page = report(one, runs / "two", output=tmp_path / "several")
    header = rows(tmp_path / "several" / "one_step_dam_break.csv")[0]
    assert {"skill, one", "skill, two"} <= {*header}
    assert rows(tmp_path / "several" / "one_step_wave.csv")[0][1] == "skill"
    assert f"two has no results on these data, but on {SAMPLE / 'test.h5'}." in page.words

    # Data of the same hash at another stride are other data.
    other = Path(shutil.copytree(runs / "two", tmp_path / "two"))
    (results(other) / DATA_FILE).write_text(json.dumps({**identity(SAMPLE), "stride": 2}))
    page = report(runs / "one", other, output=tmp_path / "strides")
    assert "two has no results on these data" in page.text
    assert (tmp_path / "strides" / "one_step_dam_break_2.csv").is_file()

    with h5py.File(wave / "test.h5", "r+") as file:
        file.attrs["viscosity"] = 0.25
    page = report(one, output=tmp_path / "changed")
    assert f"{wave / 'test.h5'} has changed since one was measured" in page.text
    assert f"{SAMPLE / 'test.h5'} has changed" not in page.text


def test_results_of_an_old_run_are_shown(runs: Path, one: Path, tmp_path: Path) -> None:
    """Its tables lie in its own folder, some under old names."""
    for path in [*results(one).iterdir()]:
        path.rename(one / path.name)
    shutil.rmtree(one / RESULTS)
    (one / DATA_FILE).unlink()
    (one / "rollout_metrics_predict.csv").rename(one / "rollout.csv")
    table = "global feature of,skill\nthe frame itself,0.5\nanother frame,0.25\n"
    (one / "foreign_context.csv").write_text(table)
    page = report(one, output=tmp_path / "single")
    for name in ("one_step", "rollout", "rollout_metrics"):
        assert len(rows(tmp_path / "single" / f"{name}.csv")) == len(rows(one / f"{name}.csv"))
    assert rows(tmp_path / "single" / "global_feature_permutation_one.csv")[2][1] == "0.25"
    assert len(page.all("img")) == len([*one.glob("*.png")]) >= 2
    note = "The data that one was measured on are not noted"
    assert note in page.text
    # Its results are not set beside those on data that are noted.
    page = report(one, runs / "two", output=tmp_path / "several")
    assert note in page.text
    assert f"two has no results on these data, but on {SAMPLE / 'test.h5'}." in page.words
    assert rows(tmp_path / "several" / "one_step_data_not_noted.csv")[0][1] == "skill"
    # Tested once more, it has both, the new ones first.
    shutil.copytree(results(runs / "one"), one / RESULTS / "dam_break")
    (run,) = read_runs([one])
    assert [it.label for it in run.results] == ["dam_break", "data not noted"]


def test_results_without_a_note_of_their_data_are_named(one: Path, tmp_path: Path) -> None:
    (results(one) / DATA_FILE).write_text("{")
    page = report(one, output=tmp_path / "report")
    assert "one: results/dam_break/data.json cannot be read: it notes no data." in page.words
    assert (tmp_path / "report" / "one_step.csv").is_file()


@pytest.mark.parametrize("count", [2, 3])
def test_every_curve_is_in_the_legend(count: int) -> None:
    lines = [Line(f"_{letter}: loss", ((0, 1.0), (1, 2.0))) for letter in "abc"[:count]]
    svg = draw(lines, "loss", "name")
    assert all(f">{line.label}<" in svg for line in lines)


def test_runs_have_the_shortest_names_that_tell_them_apart() -> None:
    assert names([Path("/runs/demo"), Path("/runs/other")]) == ["demo", "other"]
    assert names([Path("/a/version_0")]) == ["a/version_0"]
    assert names([Path("/x/a/b"), Path("/y/a/b")]) == ["x/a/b", "y/a/b"]


def test_columns_that_agree_stand_once() -> None:
    header = ("steps", "model", "still")
    cells = [(1, 0.5, 2.0), (5, 0.75, 3.0)], [(1, 0.5, 2.00001), (2, 1.0, 2.5), (5, 4.0, 3.0)]
    one, other = (pd.DataFrame(it, columns=header, dtype=object) for it in cells)
    assert side_by_side({"a": one}) is one
    joined = side_by_side({"a": one, "b": other.iloc[::2]})
    assert [*joined.columns] == ["steps", "model, a", "model, b", "still"]
    assert joined.to_numpy().tolist() == [[1, 0.5, 0.5, 2.0], [5, 0.75, 4.0, 3.0]]
    joined = side_by_side({"a": one, "b": other})
    assert joined.to_numpy().tolist() == [
        [1, 0.5, 0.5, 2.0, 2.00001], [2, "–", 1.0, "–", 2.5], [5, 0.75, 4.0, 3.0, 3.0],
    ]  # fmt: skip
    assert [*joined.columns][3:] == ["still, a", "still, b"]


def test_numbers_are_written_for_a_reader() -> None:
    values = [0.0, 3, 12345, 12345.6, 0.123456, 3.8e-5, float("inf"), "–"]
    assert [shown(value) for value in values] == [
        "0", "3", "12,345", "12,346", "0.1235", "3.8e-05", "inf", "–",
    ]  # fmt: skip
