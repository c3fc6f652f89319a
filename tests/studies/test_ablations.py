"""The ablation study's command: running, resuming and refusing trainings."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest
import yaml

from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.reporting.results import results_folders
from fluidsnet.studies.training import NOTE, Training
from tools.processes import started

ROOT = Path(__file__).parents[2]

RUNS = json.dumps([{"scene": "sample", "strides": [1], "seeds": [3]}])


def options(folder: Path, steps: int) -> list[str]:
    fit = [
        f"--trainer.max_steps={steps}",
        "--trainer.val_check_interval=2",
        "--trainer.limit_val_batches=2",
        "--trainer.limit_test_batches=2",
        "--data.init_args.sample_every=2",
    ]
    return ["ablations", f"--runs={RUNS}", f"--fit={json.dumps(fit)}", f"--output={folder}"]


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    """Change to the folder of the shipped configs and data."""
    monkeypatch.chdir(ROOT)


def test_an_interrupted_study_goes_on_and_ends_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "study"
    run = folder / "sample" / "stride_1" / "seed_3"
    arguments = options(folder, 24)
    checkpoint = run / "checkpoints" / "last.ckpt"
    # The keyboard signals the whole process group, a scheduler the study alone.
    for number, send, status in ((signal.SIGINT, os.killpg, 130), (signal.SIGTERM, os.kill, 143)):
        output = tmp_path / "output.txt"
        with started(arguments, output, first=os.setsid) as study:
            assert study.pid is not None
            before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
            deadline = time.monotonic() + 120
            while time.monotonic() < deadline:
                if checkpoint.exists() and checkpoint.stat().st_mtime_ns > before:
                    break
                time.sleep(0.05)
            with suppress(ProcessLookupError):
                send(study.pid, number)
            study.join(60)
            assert study.exitcode == status, output.read_text()
        assert json.loads((run / NOTE).read_text())["done"] == []

    main(arguments)
    assert json.loads((run / NOTE).read_text())["done"] == ["fit", "test"]
    assert "Restored all states from the checkpoint" in (run / "fit.log").read_text()
    (results,) = results_folders(run)
    for name in ("one_step.csv", "rollout_metrics.csv", "global_feature_permutation.csv"):
        assert (results / name).exists()
    assert (folder / "ablations.md").read_text() in capsys.readouterr().out

    # A finished study writes the report only.
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    (folder / "ablations.md").unlink()
    main(arguments)
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before
    assert (folder / "ablations.md").exists()

    # Other options make another study.
    with pytest.raises(SystemExit, match="1"):
        main(options(folder, 25))
    assert "was trained with other options or configs" in capsys.readouterr().err


def a_training(folder: Path, steps: int, *more: str) -> Training:
    names = ("trainer.yaml", "model/paper.yaml", "data/sample.yaml", "study/ablations.yaml")
    arguments = [f"--trainer.max_steps={steps}", "--trainer.val_check_interval=2"]
    small = ["--trainer.limit_val_batches=2", "--data.init_args.sample_every=4"]
    configs = [Path("configs", name) for name in names]
    return Training(folder, configs, [*arguments, *small, *more], 1)


def child_in(folder: Path) -> int:
    """Return the id of the process that trains in a folder."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            command = (process / "cmdline").read_text().split("\0")
            # Its data loader's workers have the same command line but another parent.
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
            if f"--trainer.logger.init_args.save_dir={folder}" in command and parent == os.getpid():
                return int(process.name)
    raise AssertionError("no process trains")


def test_a_fit_limited_by_epochs_must_save_weights(tmp_path: Path) -> None:
    short = "--trainer.limit_train_batches=2"
    a_training(tmp_path / "one", -1, short, "--trainer.max_epochs=1").run("fit")
    assert json.loads((tmp_path / "one" / NOTE).read_text())["done"] == ["fit"]
    with pytest.raises(UserError, match="saved no weights"):
        a_training(tmp_path / "none", -1, short, "--trainer.max_epochs=0").run("fit")
    assert json.loads((tmp_path / "none" / NOTE).read_text())["done"] == []


def test_unsaved_last_weights_are_an_error(tmp_path: Path) -> None:
    run = a_training(tmp_path / "run", 3)
    with pytest.raises(UserError, match="saved the weights of step 2 of 3"):
        run.run("fit")
    assert json.loads((tmp_path / "run" / NOTE).read_text())["done"] == []


@pytest.mark.usefixtures("default_signals")
@pytest.mark.parametrize(
    ("number", "sentence"),
    [(signal.SIGTERM, "terminated"), (signal.SIGKILL, "was killed by signal 9")],
)
def test_a_fit_ended_by_a_signal_is_not_done(
    tmp_path: Path, number: signal.Signals, sentence: str
) -> None:
    folder = tmp_path / "run"
    run = a_training(folder, 5000)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(run.run, "fit")
        deadline = time.monotonic() + 120
        while not (folder / "checkpoints" / "last.ckpt").exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        # The folder is locked.
        with pytest.raises(UserError, match=r"in use by another process .* wait for it"):
            a_training(folder, 5000).run("fit")
        os.kill(child_in(tmp_path), number)
        with pytest.raises(UserError, match=sentence):
            waiting.result(timeout=60)
    assert json.loads((folder / NOTE).read_text())["done"] == []


@pytest.mark.parametrize("text", ["", '{"arguments": [', "[]", "{}", '{"done": null}'])
def test_a_damaged_note_is_one_sentence(text: str, tmp_path: Path) -> None:
    (tmp_path / NOTE).write_text(text)
    with pytest.raises(UserError, match=rf"{NOTE} is damaged; name another --output, or delete"):
        Training(tmp_path, [], [], 1)


def test_weights_of_an_unknown_training_are_not_resumed(tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "last.ckpt").touch()
    with pytest.raises(UserError, match=f"holds weights but no {NOTE}"):
        Training(tmp_path, [], [], 1)


@pytest.mark.usefixtures("real_solver")
def test_missing_data_are_generated_and_a_failed_training_leaves_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    configs, root = tmp_path / "configs", tmp_path / "data"
    shutil.copytree(ROOT / "configs", configs)
    scene = yaml.safe_load((configs / "scene" / "sample.yaml").read_text())
    scene["recipe"] |= {"train": 1, "frames": 2}
    (configs / "scene" / "puddle.yaml").write_text(yaml.safe_dump(scene))
    data = yaml.safe_load((configs / "data" / "sample.yaml").read_text())
    data["data"]["init_args"]["root"] = str(root)
    (configs / "data" / "puddle.yaml").write_text(yaml.safe_dump(data))
    # A stride that exceeds the frames fails as soon as the training reads the data.
    scenes = [
        {"scene": "puddle", "strides": [9], "seeds": [0]},
        {"scene": "sample", "strides": [1], "seeds": [0]},
    ]
    arguments = options(tmp_path / "out", 2)
    arguments[1] = f"--runs={json.dumps(scenes)}"
    with pytest.raises(SystemExit, match="1"):
        main([*arguments, f"--configs={configs}", "--jobs=1"])
    output = capsys.readouterr()
    assert f"{root} holds train.h5, val.h5, test.h5." in output.out
    assert "no sample for train" in output.err
    assert "the same command then does the rest" in output.err
    assert "1 of 2 runs are finished" in output.out


def test_a_failed_training_says_why_and_leaves_its_folder_free(tmp_path: Path) -> None:
    config = tmp_path / "study.yaml"
    config.write_text("trainer: {max_stepz: 1}")
    configs = [*(Path("configs", f"{name}.yaml") for name in ("trainer", "model/paper")), config]
    folder = tmp_path / "run"
    early = Training(folder, configs, [], 1)
    with pytest.raises(UserError, match=r"fit of .*run failed: .*max_stepz"):
        Training(folder, configs, [], 1).run("fit")
    # Stages that another process has finished are not run again.
    note = folder / NOTE
    failed = note.read_text()
    note.write_text(json.dumps({**json.loads(failed), "done": ["fit", "test"]}))
    before = note.read_text()
    early.run("fit")
    early.run("test")
    assert early.done
    assert note.read_text() == before
    # A changed config is another training; where the first saved nothing, the folder is free.
    note.write_text(failed)
    config.write_text("trainer: {max_steps: 2}")
    Training(folder, configs, [], 1)
    (folder / "checkpoints").mkdir()
    (folder / "checkpoints" / "last.ckpt").touch()
    with pytest.raises(UserError, match="with other options or configs"):
        Training(folder, configs, [], 1)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--jobs=0"], "--jobs is 0"),
        (["--runs=[]"], "--runs names no scene"),
        (
            ['--runs=[{"scene": "sample", "strides": [], "seeds": [0]}]'],
            "needs at least one stride",
        ),
        (
            ['--runs=[{"scene": "sample", "strides": [0], "seeds": [0]}]'],
            "needs at least one stride",
        ),
        (['--runs=[{"scene": "lake", "strides": [1], "seeds": [0]}]'], "data/lake.yaml is missing"),
        (["--configs=nowhere"], "nowhere/trainer.yaml is missing"),
        (["--steps=3"], "steps"),
        (['--fit=["--config=my.yaml"]'], "not --config=my.yaml; files belong in the folder of"),
        (['--fit=["-c", "my.yaml"]'], "not -c; files belong in the folder of"),
        (['--fit=["--data=my.yaml"]'], "not --data=my.yaml; files belong in the folder of"),
        (['--fit=["--seed_everything=1"]'], "takes single settings such as"),
        (['--fit=["--data.init_args.root=here"]'], "set the data of each scene in configs/data"),
        (['--fit=["--data.init_args.root", "here"]'], "set the data of each scene in configs/data"),
        (['--fit=["--data.root=here"]'], "set the data of each scene in configs/data"),
    ],
)
def test_an_invalid_option_is_one_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="1"):
        main(["ablations", *arguments, f"--output={tmp_path / 'study'}"])
    errors = capsys.readouterr().err
    assert errors.startswith("fluidsnet: ") and sentence in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "study").exists()
