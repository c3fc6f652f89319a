"""The ablations' study: what it runs, what it goes on with, and what it refuses."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fluidsnet.main import main
from fluidsnet.studies.ablations.training import NOTE

ROOT = Path(__file__).parents[2]

RUNS = json.dumps([{"scene": "sample", "strides": [1], "seeds": [3]}])


def options(folder: Path, steps: int) -> list[str]:
    fit = [
        f"--trainer.max_steps={steps}",
        "--trainer.val_check_interval=2",
        "--trainer.limit_val_batches=1",
        "--trainer.limit_test_batches=2",
        "--data.init_args.sample_every=2",
    ]
    return ["ablations", f"--runs={RUNS}", f"--fit={json.dumps(fit)}", f"--output={folder}"]


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the shipped configs and the data that they name are."""
    monkeypatch.chdir(ROOT)


def test_an_interrupted_study_goes_on_and_ends_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "study"
    run = folder / "sample" / "stride_1" / "seed_3"
    words = options(folder, 24)
    study = subprocess.Popen(
        [sys.executable, "-m", "fluidsnet.main", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # A group of its own, which an interrupt from the keyboard reaches as a whole.
        start_new_session=True,
    )
    checkpoint = run / "checkpoints" / "last.ckpt"
    deadline = time.monotonic() + 120
    while not checkpoint.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(study.pid, signal.SIGINT)
    _, said = study.communicate(timeout=60)
    assert study.returncode == 130, said
    assert json.loads((run / NOTE).read_text())["seconds"] == {}

    main(words)
    assert set(json.loads((run / NOTE).read_text())["seconds"]) == {"fit", "test"}
    assert "Restored all states from the checkpoint" in (run / "fit.log").read_text()
    for name in ("one_step.csv", "rollout_metrics.csv", "foreign_context.csv"):
        assert (run / name).exists()
    assert (folder / "ablations.md").read_text() in capsys.readouterr().out

    # Again, and nothing is done but the report.
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    (folder / "ablations.md").unlink()
    main(words)
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before
    assert (folder / "ablations.md").exists()

    # With other options it would be another study.
    with pytest.raises(SystemExit, match="1"):
        main(options(folder, 25))
    assert "was trained with other options" in capsys.readouterr().err


def test_a_training_that_fails_is_said_and_takes_no_other_along(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = options(tmp_path, 2)
    words[1] = f"--runs={json.dumps([{'scene': 'sample', 'strides': [999], 'seeds': [0]}])}"
    with pytest.raises(SystemExit, match="1"):
        main(words)
    said = capsys.readouterr()
    assert "no sample for train" in said.err
    assert "The same command again" in said.err
    assert "0 of 1" in said.out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--jobs=0"], "--jobs is 0"),
        (["--runs=[]"], "--runs names no scene"),
        (['--runs=[{"scene": "sample", "strides": [], "seeds": [0]}]'], "needs strides from 1 on"),
        (['--runs=[{"scene": "sample", "strides": [0], "seeds": [0]}]'], "needs strides from 1 on"),
        (['--runs=[{"scene": "lake", "strides": [1], "seeds": [0]}]'], "data/lake.yaml is missing"),
        (["--configs=nowhere"], "nowhere/trainer.yaml is missing"),
        (["--steps=3"], "steps"),
    ],
)
def test_what_cannot_be_run_is_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="1"):
        main(["ablations", *words, f"--output={tmp_path / 'study'}"])
    said = capsys.readouterr().err
    assert said.startswith("fluidsnet: ") and sentence in said
    assert "Traceback" not in said
    assert not (tmp_path / "study").exists()
