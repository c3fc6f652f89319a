"""The trade study: true states continued by the real solver and by priors, and its tables."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datamodules.generate.box_drops import BoxDrops
from datamodules.generate.dataset import generate
from datamodules.generate.recipe import Recipe
from datamodules.generate.replay import Replay, replay
from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.priors import PressureStep
from fluidsnet.studies.parser import study_parser
from fluidsnet.studies.trade import engine
from fluidsnet.studies.trade.measure import measure
from fluidsnet.studies.trade.model_points import ModelSteps
from fluidsnet.studies.trade.options import ModelPoint, SolverPoint, TradeOptions
from fluidsnet.studies.trade.points import Continued, Cost, Point, Runs
from fluidsnet.studies.trade.solver_points import Solver
from fluidsnet.studies.trade.study import Study

PRIOR = Path(__file__).parents[2] / "configs" / "model" / "prior.yaml"
CORRECTED = PRIOR.with_name("corrected.yaml")

#: Coarse and small, for the solver.
RECIPE = Recipe(
    scene=BoxDrops(
        width=(1.0, 1.2), height=(1.0, 1.0), depth=(0.8, 1.0), bodies=(2, 2), volume=(0.08, 0.12)
    ),
    particle_radius=0.04,
    train=0,
    val=0,
    test=2,
    frames=15,
    frame_interval=0.02,
    solver="DFSPH",
)


@pytest.fixture(scope="module")
def drops(tmp_path_factory: pytest.TempPathFactory, real_solver: None) -> Path:
    """The data file of two simulations."""
    root = tmp_path_factory.mktemp("drops")
    generate(RECIPE, root, processes=1)
    return root / "test.h5"


def nothing() -> None:
    pass


def test_the_datas_own_solver_continues_a_true_state_to_the_next(drops: Path) -> None:
    reader = FrameReader(drops)
    name = list(reader.frames)[1]
    job = Replay(
        data=str(drops), simulation=name, solver="DFSPH", solver_step=0.0025, tolerance=0.05,
        threads=1, runs=[(8, 2), (2, 1), (0, 3)],
    )  # fmt: skip
    found = list(replay(job, nothing))
    assert [(run, frame) for run, frame, _ in found] == [
        *[(0, 1), (0, 2), (1, 1), (2, 1), (2, 2), (2, 3)]
    ]
    for run, frame, state in found:
        first = job.runs[run][0]
        position, velocity = reader.fluid(name, first + frame)
        error = np.linalg.norm(state.position - position.numpy(), axis=1).mean()
        before = reader.fluid(name, first)
        kept = before[0] + 0.02 * frame * before[1]
        assert error < 1.5e-4
        assert error < 0.1 * (kept - position).norm(dim=1).mean()
        assert np.abs(state.velocity - velocity.numpy()).mean() < 0.01
        assert state.wall > 0 and state.cpu > 0


def test_a_solver_step_may_last_several_frames(drops: Path) -> None:
    reader = FrameReader(drops)
    name = next(iter(reader.frames))
    point = Solver(SolverPoint("DFSPH", 0.04, 1.0), drops, 1)
    made = list(point.continued(reader, name, [(0, 5)], nothing))
    assert point.stride == 2 and [it.frame for it in made] == [2, 4]
    # The bodies fall: v = g t, and symplectic Euler moves them by g t² after one step.
    start = reader.state(name, 0, 1)
    moved = made[0].state.position - start.position - 0.04 * start.velocity
    assert moved[:, 1].median() == pytest.approx(-9.81 * 0.04**2, rel=0.05)


def test_a_solver_that_makes_no_state_is_named_with_its_reason(drops: Path) -> None:
    job = Replay(
        data=str(drops), simulation="00007", solver="DFSPH", solver_step=0.0025, tolerance=0.05,
        threads=1, runs=[(0, 1)],
    )  # fmt: skip
    with pytest.raises(UserError, match=r"DFSPH at 2.5 ms ended before its first state of .*00007"):
        list(replay(job, nothing))


def study(drops: Path, output: Path, solvers: list[Any], models: list[Any], *more: str) -> None:
    main(
        [
            *("trade", f"--data={drops}", f"--output={output}", f"--solvers={json.dumps(solvers)}"),
            *(f"--models={json.dumps(models)}", "--threads=1", "--every=5", "--horizon=4"),
            *("--steps=12", "--marks=[6,12]", "--simulations=2", *more),
        ]
    )


def table(output: Path) -> dict[tuple[str, str, int], list[float]]:
    """Return values of all simulations by point, result and frames."""
    values: dict[tuple[str, str, int], list[float]] = {}
    with (output / "trade.csv").open() as file:
        for row in csv.DictReader(file):
            key = row["point"], row["result"], int(row["frames"])
            values.setdefault(key, []).append(float(row["value"]))
    return values


def test_a_study(drops: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    solvers = [
        {"solver": "DFSPH", "step": 0.0025, "tolerance": 0.05},
        {"solver": "DFSPH", "step": 0.02, "tolerance": 1.0},
    ]
    models = [
        {"model": str(PRIOR), "label": "prior"},
        {"model": str(PRIOR), "label": "prior 40 ms", "stride": 2},
    ]
    study(drops, tmp_path, solvers, models[:1])
    points = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "points").iterdir()}
    # In each simulation: two trivial points, two floors, the solvers and the prior.
    assert len(points) == 2 * (2 + 2 + 2 + 1), points
    # Goes on: what is finished is not measured again.
    study(drops, tmp_path, solvers, models)
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "points").iterdir()}
    assert len(after) == len(points) + 2 and points.items() <= after.items()
    values = table(tmp_path)
    assert {len(it) for it in values.values()} == {2}
    careful, careless = "DFSPH 2.5 ms, 0.05%", "DFSPH 20 ms, 1%"
    for simulation in range(2):
        errors = {
            label: values[label, "error_mm", 1][simulation]
            for label in (careful, careless, "prior", "constant velocity")
        }
        assert errors[careful] < 0.3 * errors["prior"]
        assert errors["prior"] < errors[careless] < errors["constant velocity"]
        assert values["constant velocity", "skill", 1][simulation] <= 0
        assert values[careful, "skill", 1][simulation] > values["prior", "skill", 1][simulation]
        assert values["prior", "skill", 1][simulation] > 0.8
        # In the first frames the bodies only fall, which the prior knows exactly.
        assert values["prior", "rollout_mm", 12][simulation] < 20
        # A step of two frames has no state after one or three.
        missing = [values["prior 40 ms", "error_mm", it][simulation] for it in range(1, 5)]
        assert [math.isnan(it) for it in missing] == [True, False, True, False]
    for label in (careful, careless, "prior", "prior 40 ms"):
        assert min(values[label, "wall_s", 1]) > 0 and min(values[label, "cpu_s", 1]) > 0
    text = (tmp_path / "trade.md").read_text()
    assert text in capsys.readouterr().out
    assert (tmp_path / "trade.png").stat().st_size > 10_000
    assert "truth: DFSPH with steps of 2.5 ms" in text and "prior 40 ms" in text
    # The floor is close to the truth, and not the truth.
    moved = values["floor: start moved", "rollout_mm", 12]
    assert all(0 < it < 0.1 * values[careless, "rollout_mm", 12][0] for it in moved)
    assert min(values[careful, "memory_mb", 1]) > 1 and min(values[careful, "setup_s", 1]) > 0
    page = (tmp_path / "trade.html").read_text()
    assert f"<title>{careless}: " in page and "0.24 s into a rollout, " in page
    # The finished study answers questions; limits from its own table.
    errors = {label: np.mean(values[label, "rollout_mm", 12]) for label in (careful, careless)}
    costs = {
        label: np.median(values[label, "cpu_s", 1])
        for label in (careful, careless, "prior", "prior 40 ms")
    }
    between = (errors[careful] + errors[careless]) / 2
    cheapest = min((it for it in costs if it != careless), key=lambda it: costs[it])
    ask(tmp_path, f"--max_error={between}", "--after=0.24")
    answer = capsys.readouterr().out
    assert answer.startswith(f"{cheapest} (") and "mm after 0.24 s of a rollout" in answer
    ask(tmp_path, "--max_seconds=1000", "--after=0.24")
    answer = capsys.readouterr().out
    assert answer.startswith(f"{careful} (solver)") and '"timeStepSize": 0.0025' in answer
    assert "The next best of the other side" in answer
    for options, message in (
        (("--max_error=1e-9",), "the least error is"),
        ((), "Give --max_error in mm, --max_seconds, or both."),
        (("--max_seconds=-1",), "--max_seconds is -1.0; set it above zero."),
    ):
        with pytest.raises(SystemExit):
            ask(tmp_path, *options)
        assert message in capsys.readouterr().err


def ask(output: Path, *options: str) -> None:
    main(["trade", "recommend", f"--study={output}", *options])


def test_a_study_that_is_not_there_or_damaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        ask(tmp_path, "--max_error=1")
    assert "run `fluidsnet trade` first" in capsys.readouterr().err
    (tmp_path / "trade.json").write_text('{"rows": [{"label": "x"}], "marks": [1]}')
    with pytest.raises(SystemExit):
        ask(tmp_path, "--max_error=1")
    assert "is damaged; run `fluidsnet trade` again" in capsys.readouterr().err


def test_coarser_particles_are_compared_through_fields(drops: Path, tmp_path: Path) -> None:
    fine: dict[str, Any] = {"solver": "DFSPH", "step": 0.0025}
    study(
        *(drops, tmp_path, [fine, {**fine, "coarsen": 2}], []),
        *("--simulations=1", "--floor=false"),
    )
    values, coarse = table(tmp_path), "DFSPH 2.5 ms, 0.05%, 2 radii"
    assert (coarse, "rollout_mm", 12) not in values and (coarse, "error_mm", 1) not in values
    misplaced = [
        values[label, "misplaced", 12][0]
        for label in ("DFSPH 2.5 ms, 0.05%", coarse, "constant velocity")
    ]
    assert 0 <= misplaced[0] < 0.01 < misplaced[1] < 0.4
    # The bodies fall 0.28 m in this time.
    assert misplaced[1] < misplaced[2]
    assert values[coarse, "cpu_s", 1][0] < 0.7 * values["DFSPH 2.5 ms, 0.05%", "cpu_s", 1][0]


def test_a_cluster_of_two_workers_gives_the_same_errors(drops: Path, tmp_path: Path) -> None:
    solvers = [{"solver": "DFSPH", "step": 0.01, "tolerance": 1.0}]
    models = [{"model": str(PRIOR), "label": "prior"}]
    study(drops, tmp_path / "one", solvers, models, "--floor=false")
    study(drops, tmp_path / "two", solvers, models, "--floor=false", "--workers=2")
    one, two = table(tmp_path / "one"), table(tmp_path / "two")
    costs = {"wall_s", "cpu_s", "setup_s", "memory_mb"}
    assert one.keys() == two.keys()
    for key, values in one.items():
        if key[1] not in costs:
            assert two[key] == pytest.approx(values, rel=1e-6, nan_ok=True), key


def test_a_scheduler_that_is_not_there(
    sample: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(engine, "CONNECT", "1s")
    with pytest.raises(SystemExit):
        study(sample / "test.h5", tmp_path, [], [], "--scheduler=tcp://127.0.0.1:1")
    assert "--scheduler tcp://127.0.0.1:1" in capsys.readouterr().err


def test_a_point_that_fails_is_a_row_that_says_why(sample: Path, tmp_path: Path) -> None:
    config = tmp_path / "prior.yaml"
    config.write_text(PRIOR.read_text())
    options = TradeOptions(
        str(sample / "test.h5"),
        [],
        [ModelPoint(str(PRIOR)), ModelPoint(str(config), label="gone")],
        simulations=1, every=10, horizon=2, steps=4, marks=[4], threads=1,
        output=str(tmp_path / "study"),
    )  # fmt: skip
    failing = Study(options)
    config.unlink()
    failing.run()
    text = (tmp_path / "study" / "trade.md").read_text()
    assert "gone (failed)" in text and f"- gone failed in 00000: UserError: {config}" in text
    # It is measured once it can be.
    config.write_text(PRIOR.read_text())
    Study(options).run()
    assert "failed" not in (tmp_path / "study" / "trade.md").read_text()


def test_quick_with_data_and_a_run_of_ones_own(sample: Path, tmp_path: Path) -> None:
    configs = PRIOR.parents[1]
    names = ("trainer.yaml", "model/paper.yaml", "data/sample.yaml")
    training = {
        "label": "paper",
        "configs": [str(configs / name) for name in names],
        "options": [
            f"--data.init_args.root={sample}",
            "--trainer.callbacks=[{class_path: lightning.pytorch.callbacks.ModelCheckpoint, "
            "init_args: {filename: last, enable_version_counter: false}}]",
        ],
    }
    data = tmp_path / "mine.h5"
    shutil.copy(sample / "test.h5", data)
    study(
        *(data, tmp_path / "out", [], []),
        *(f"--trainings={json.dumps([training])}", "--quick=true", "--budget=4"),
    )
    run = tmp_path / "out" / "models" / "paper"
    assert (run / "checkpoints" / "last.ckpt").exists()
    values = table(tmp_path / "out")
    assert len(values["paper", "error_mm", 1]) == 1 and values["paper", "cpu_s", 1][0] > 0
    # A run is a point, too, with what can be changed of a network without training.
    variants = [
        {"model": str(run), "label": "run"},
        {"model": str(run), "label": "8 neighbors", "neighbors": 8},
        {"model": str(run), "label": "bf16", "precision": "bf16-mixed"},
    ]
    study(data, tmp_path / "out", [], variants, "--quick=true")
    values = table(tmp_path / "out")
    errors = [values[str(it["label"]), "error_mm", 1][0] for it in variants]
    assert errors[0] != errors[1] and errors[2] == pytest.approx(errors[0], rel=0.1)


@pytest.mark.parametrize("scene", ["box_drops", "dam_break_small", "deep"])
def test_the_points_of_the_configs_can_be_built(
    sample: Path, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(PRIOR.parents[2])
    parser = study_parser("trade", "", TradeOptions)
    parsed = vars(
        parser.instantiate(parser.parse_args([f"--config=configs/study/trade_{scene}.yaml"]))
    )
    parsed.pop("config")
    options, data = TradeOptions(**parsed), sample / "test.h5"
    solvers = [Solver(point, data, 1) for point in options.solvers]
    for training in options.trainings:
        assert all(Path(config).is_file() for config in training.configs)
    labels = [point.label for point in solvers] + [it.name for it in options.models]
    labels += [it.label for it in options.trainings]
    assert len(set(labels)) == len(labels) > 10


def test_points_of_other_defaults_are_other_points(
    sample: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(PRIOR.parents[2])
    parser = study_parser("trade", "", TradeOptions)
    config = "configs/study/trade_box_drops.yaml"
    parsed = vars(parser.instantiate(parser.parse_args([f"--config={config}"])))
    parsed.pop("config")
    reader = FrameReader(sample / "test.h5")
    points = [ModelSteps(point, reader, 1) for point in TradeOptions(**parsed).models]
    assert {point.kind for point in points} == {"prior alone"}
    assert {point.stride for point in points} == {1, 2, 4}
    assert len({json.dumps(point.settings) for point in points}) == len(points) > 10
    # Results of other defaults are not those of this prior.
    prior = points[0].settings["described"]["prior"]
    assert (prior["searches"], prior["relaxation"]) == (1, PressureStep().relaxation)


class EndsEarly(Point):
    """The truth, and nothing after two frames."""

    label, kind = "ends early", "solver"

    @property
    def settings(self) -> dict[str, Any]:
        return {}

    @property
    def advice(self) -> str:
        return ""

    def continued(
        self, reader: FrameReader, simulation: str, runs: Runs, advance: Callable[[], None]
    ) -> Iterator[Continued]:
        for run, (first, frames) in enumerate(runs):
            for frame in range(1, min(frames, 2) + 1):
                state = reader.state(simulation, first + frame, 1)
                yield Continued(run, frame, state, Cost(1.0, 1.0, 0.0, 0.0))


def test_a_solver_that_ends_early_has_infinite_errors_from_there(sample: Path) -> None:
    reader = FrameReader(sample / "test.h5")
    options = TradeOptions(horizon=4, steps=8, marks=[2, 8], every=10)
    found = measure(EndsEarly(), reader, next(iter(reader.frames)), options, nothing)
    assert found.values["error_mm"][2] == 0 and found.values["skill"][2] == 1
    assert found.values["error_mm"][3] == math.inf
    assert found.values["rollout_mm"] == {2: 0.0, 8: math.inf}
    assert found.values["non_finite"] == {2: 0.0, 8: 1.0}


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--simulations=0", "--simulations is 0; it must be at least 1."),
        ("--marks=[6,13]", "give frames from 1 to --steps, 12"),
        ("--threads=1000", "--threads is 1000"),
        ("--data=nowhere.h5", "nowhere.h5"),
    ],
)
def test_options_that_cannot_be_used(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, message: str
) -> None:
    with pytest.raises(SystemExit):
        study(sample / "test.h5", tmp_path, [], [], option)
    assert message in capsys.readouterr().err


def test_points_that_cannot_be_measured(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = sample / "test.h5"
    prior = {"model": str(PRIOR), "label": "same"}
    for solvers, models, message in (
        ([], [prior, prior], "Two points have the same label"),
        ([], [{"model": str(CORRECTED)}], "describes a network without weights"),
        ([], [{**prior, "stride": 5}], "--horizon is 4, and same steps 5 frames at once"),
    ):
        with pytest.raises(SystemExit):
            study(data, tmp_path, solvers, models)
        assert message in capsys.readouterr().err
    reader = FrameReader(data)
    with pytest.raises(UserError, match=r"step of 0.007 s neither divides the frame interval"):
        Solver(SolverPoint("DFSPH", 0.007), data, 1)
    with pytest.raises(UserError, match=r"is a prior alone: neighbors, precision and compiled"):
        ModelSteps(ModelPoint(str(PRIOR), neighbors=8), reader, 1)
    with pytest.raises(UserError, match=r"models: neighbors is 0; it must be at least 1"):
        ModelPoint("runs/any", neighbors=0)
    with pytest.raises(UserError, match=r"step is 0; set it above zero"):
        SolverPoint("DFSPH", 0)
    assert ModelSteps(ModelPoint(str(PRIOR), 3), reader, 1).stride == 3
