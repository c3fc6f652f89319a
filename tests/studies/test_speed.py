from __future__ import annotations

import csv
import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datamodules.reader import FrameReader
from fluidsnet.main import main
from fluidsnet.network import Network
from fluidsnet.studies.dam_break import Dam
from fluidsnet.studies.speed import command
from fluidsnet.studies.speed import trial as speed_trial
from fluidsnet.studies.speed.floor import step_floor
from fluidsnet.studies.speed.measure import load_model, measure
from fluidsnet.studies.speed.report import Report, number
from fluidsnet.studies.speed.trial import Result, SpeedOptions, Trial, run_trial

MODELS = Path(__file__).parents[2] / "configs" / "model"

needs_solver = pytest.mark.skipif(
    importlib.util.find_spec("pysplishsplash") is None, reason="pysplishsplash is not installed"
)


def _table(folder: Path) -> list[dict[str, str]]:
    with (folder / "speed.csv").open() as file:
        return list(csv.DictReader(file))


@needs_solver
def test_a_tiny_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--particles=[1000]", "--repeats=2", "--frames=2", "--batch=0", "--threads=1"]
    ways = ["--solvers=[IISPH]", "--neighbors=[Auto]"]
    main(["speed", *words, *ways, f"--output={tmp_path}"])
    rows = _table(tmp_path)
    methods = [(row["method"], row["precision"]) for row in rows]
    assert methods == [("IISPH", ""), ("network", "float32")]
    assert {row["note"] for row in rows} == {""}
    iisph, exact = rows
    for row in rows:
        step = float(row["step s"])
        assert 0 < float(row["step least s"]) <= step <= float(row["step most s"])
        assert float(row["s per simulated s"]) == pytest.approx(step / 0.02)
        assert float(row["particles per s"]) == pytest.approx(1008 / step)
        assert float(row["speed-up"]) == pytest.approx(float(iisph["step s"]) / step)
    assert float(exact["error"]) < 1e-5
    assert 10 < float(exact["neighbors per particle"]) < 32
    assert float(exact["search + local s"]) > 0 and float(exact["sort s"]) > 0
    assert float(exact["peak bytes"]) > 0
    text = (tmp_path / "speed.md").read_text()
    assert text in capsys.readouterr().out
    assert "1 threads" in text and "torch-cluster" in text and "50.51" in text
    assert (tmp_path / "speed.png").stat().st_size > 10_000
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"speed.csv", "speed.md", "speed.png"}


@pytest.mark.parametrize("count", [1000, 4000, 30000, 125000, 300000, 618043, 2000000])
def test_a_dam_of_any_size(count: int) -> None:
    dam = Dam.of(count)
    assert dam.particles == pytest.approx(count, rel=0.01)
    assert np.allclose(np.array(dam.domain) / dam.domain[0], [1, 4 / 6, 1])
    recipe = dam.recipe("IISPH", 2, 0.02, 0.004)
    (block,) = recipe.starts()["train", 0].bodies
    lower, upper = block.bounds()
    assert np.array_equal(np.rint((upper - lower) / 0.1), dam.layers)


def test_the_papers_own_scene_has_the_papers_domain() -> None:
    assert Dam.of(46430).domain == pytest.approx((6.0, 4.0, 6.0), rel=1e-3)


def test_the_start_without_a_solver(tmp_path: Path) -> None:
    dam = Dam.of(1000)
    dam.write_start(tmp_path / "start.h5", 2, 0.02)
    reader = FrameReader(tmp_path / "start.h5")
    state = reader.state("00000", 2, stride=1)
    assert len(state) == dam.particles
    assert (state.position > 0).all() and (state.position < state.scene.domain_upper).all()
    options = SpeedOptions(repeats=1, threads=1, batch=2)
    base = Trial("reference", options, dam.particles, tmp_path / "start.h5")
    assert measure(base).failure == ""
    for neighbors in ("CellList", "TorchCluster"):
        found = measure(replace(base, kind="step", neighbors=neighbors))
        assert found.error is not None and found.error < 1e-5
        assert set(found.stages) == {"search", "local", "voxel", "global", "head"}
    half = measure(replace(base, kind="step", precision="bfloat16"))
    assert half.error is not None and 0 < half.error < 0.1
    many = measure(replace(base, kind="batch"))
    assert sum(many.batches) == 2


def _network(neighbors: str = "Auto", model: Path | None = None) -> Network:
    loaded = load_model(SpeedOptions(model=None if model is None else str(model)), neighbors)
    assert not loaded.training
    return loaded.network


def test_any_model() -> None:
    for path in sorted(MODELS.glob("*.yaml")):
        assert type(_network("CellList", path).neighbors).__name__ == "CellList"
    known = {name: value.shape for name, value in _network().state_dict().items()}
    written = _network(model=MODELS / "paper.yaml")
    assert {name: value.shape for name, value in written.state_dict().items()} == known
    assert step_floor(_network(model=MODELS / "field.yaml"), 9, 9.0) is None


def test_the_floor_counts_the_papers_layers() -> None:
    found = step_floor(_network(), 1, 30.0)
    assert found is not None
    # By hand: Table 1's layers, 16 operations a tanh, the mean of nine numbers.
    edge = 7 + 16 * 7 + 2 * 7 * 9 + 16 * 9 + 9
    voxel = 16 * (2 * 16 + 17) + 32 * (2 * 16 + 17) + 64 * (2 * 32 + 17)
    head = 32 * (2 * 16 + 16) + 16 * (2 * 32 + 16) + 8 * (2 * 16 + 16) + 3 * (2 * 8)
    assert found["operations"] == 30 * edge + 2 * 7 * 7 + voxel + head
    assert found["bytes"] == 48 + 2 * 64


def test_what_was_skipped_says_so(tmp_path: Path) -> None:
    result = Result(failure="skipped: why")
    trial = Trial("step", SpeedOptions(), 1000, neighbors="TorchCluster")
    report = Report(rows=[(trial, result)])
    assert "skipped: why" in report.write(tmp_path)
    (row,) = _table(tmp_path)
    assert row["note"] == "skipped: why" and row["step s"] == "" == row["speed-up"]


def test_a_failed_process_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = SpeedOptions(threads=1, seconds=0.01)
    missing = Trial("step", options, 1000, tmp_path / "none.h5")
    assert "none.h5" in run_trial(missing).failure
    Dam.of(1000).write_start(missing.states, 2, 0.02)
    assert "AttributeError" in run_trial(replace(missing, neighbors="Nonsense")).failure
    monkeypatch.setattr(speed_trial, "START", 0.1)
    assert run_trial(missing).failure == "skipped: beyond 0.01 s"


def _study(
    folder: Path, monkeypatch: pytest.MonkeyPatch, solver: str = "none", **results: Result
) -> str:
    """The page of a tiny study whose processes leave these results, by kind of trial."""

    def run_trial(trial: Trial) -> Result:
        return results.get(trial.kind, Result())

    monkeypatch.setattr(command, "run_trial", run_trial)
    # The paper's scenes take minutes.
    monkeypatch.setattr(command, "TABLE_3_PARTICLES", (1000,))
    words = ["--particles=[1000]", "--batch=2", "--threads=1", "--neighbors=[Auto]"]
    main(["speed", *words, f"--solvers=[{solver}]", f"--output={folder}"])
    return (folder / "speed.md").read_text()


def _load(*cores: float) -> type:
    """In place of `OtherLoad`: what others take during one measurement after another."""
    left = iter(cores)

    class Load:
        def __enter__(self) -> Load:
            self.cores = next(left)
            return self

        def __exit__(self, *_: object) -> None:
            pass

    return Load


CORES = Result(cores={"bandwidth": 3e10, "flops": 2e11})
STEP = Result(step=[0.01], edges=27.0)
BATCH = Result(step=[0.04], batches=[2])


def test_without_the_cores_there_is_no_floor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = _study(tmp_path / "whole", monkeypatch, cores=CORES, step=STEP)
    assert "A copy moves 30.0 GB/s" in page and "Gflop |" in page
    page = _study(tmp_path, monkeypatch, cores=Result(failure="out of memory"), step=STEP)
    assert "Bandwidth and arithmetic of the cores were not measured (out of memory)." in page
    assert "Gflop |" not in page
    assert [row["note"] for row in _table(tmp_path)] == [""]


def test_every_measurement_says_what_ran_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Before the first measurement, then of the cores, of the step and of the frames at once.
    monkeypatch.setattr(command, "OtherLoad", _load(0.0, 0.4, 0.0, 0.7))
    page = _study(tmp_path, monkeypatch, cores=CORES, step=STEP, batch=BATCH)
    assert "while its cores were measured: others took 0.4 cores; do not trust the floor." in page
    assert "busy during 1 of 2 measurements, others took up to 0.7 cores" in page
    assert "do not trust the times of: 1,008 particles, 2 frames at once." in page
    said = capsys.readouterr().err
    assert "others took 0.4 cores during the measurement of the cores." in said
    assert "others took 0.7 cores during 1,008 particles, 2 frames at once." in said


@needs_solver
def test_what_ran_beside_the_solver_counts_for_the_frames_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The solver runs for the size, and again for the frames.
    monkeypatch.setattr(command, "OtherLoad", _load(0.0, 0.0, 0.0, 0.0, 0.6, 0.0))
    page = _study(tmp_path, monkeypatch, "IISPH", cores=CORES, step=STEP, batch=BATCH)
    assert "busy during 1 of 3 measurements, others took up to 0.6 cores" in page
    assert "do not trust the times of: 1,008 particles, 2 frames at once." in page


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "–"),
        (0.0, "0"),
        (0.01234, "0.0123"),
        (999.4, "999"),
        (999.5, "1,000"),
        (999.99, "1,000"),
        (-999.7, "-1,000"),
        (1000.0, "1,000"),
        (125184.3, "125,184"),
    ],
)
def test_a_number_has_three_digits_and_no_exponent(value: float | None, words: str) -> None:
    assert number(value) == words


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--particles=[10]"], "from 100 on"),
        (["--particles=many"], "particles"),
        (["--neighbors=[Nearest]"], "neighbors"),
        (["--threads=4000"], "cores"),
        (["--repeats=0"], "above zero"),
        (["--solver_step=0.003"], "whole number"),
        (["--run=/nowhere"], "/nowhere is not the folder of a run"),
        (["--model=/nowhere.yaml"], "holds no `model:`"),
        (["--device=toaster"], "toaster"),
        (["--sise=3"], "sise"),
    ],
)
def test_bad_input_is_one_sentence(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["speed", *arguments, "--solvers=[none]", f"--output={tmp_path / 'speed'}"])
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert words in said and "Traceback" not in said
    assert not (tmp_path / "speed").exists()
