"""Hard cases: their scenes, the judgment, and the study with the real solver."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from test_module import data, trainer

from callbacks import OneStepTable, StressCases
from fluidsnet import FluidsNet, load
from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.metrics.density import Density
from fluidsnet.metrics.energy import kinetic_energy, potential_energy
from fluidsnet.model import Model
from fluidsnet.models.loading import build
from fluidsnet.particles import Particles
from fluidsnet.stress.cases import cases, dam, pool
from fluidsnet.stress.outcome import judge, model_states, says_of
from fluidsnet.stress.runs import prior_of, run_case
from fluidsnet.stress.scenes import GRAVITY, Setting, boxed, scaled, wall_particles, with_scene
from fluidsnet.stress.sensitivity import growth_rows, moved, precision_rows

SETTING = Setting(0.025, 0.02)
CONFIGS = Path(__file__).parents[2] / "configs" / "model"


def test_a_pool_begins_at_rest_density_inside_its_box() -> None:
    state = pool(SETTING, (8, 6, 8))
    density = Density()(state)
    assert len(state) == 8 * 6 * 8 and 0.98 < density.median() < 1.02 and density.max() < 1.03
    gap = torch.minimum(
        state.position - state.scene.domain_lower, state.scene.domain_upper - state.position
    )
    assert gap[:, [0, 2]].min() == pytest.approx(2.25 * 0.025, rel=1e-5)
    solids = state.solid_position
    walls = (solids == state.scene.domain_lower) | (solids == state.scene.domain_upper)
    assert walls.any(dim=1).all() and len(solids.unique(dim=0)) == len(solids)
    assert len(wall_particles(state.scene)) == len(solids)


def test_other_units_have_the_same_course() -> None:
    model, state = load("box_drops"), dam(SETTING)
    for factor in (1e3, 1e-3):
        start, other = state, scaled(state, factor)
        for _ in range(5):
            start, other = model.step(start), model.step(other)
        apart = (other.position / factor - start.position).norm(dim=1).max()
        assert apart < 1e-3 * SETTING.radius


def test_energies() -> None:
    state = boxed(torch.tensor([[0.1, 0.3, 0.2]]), SETTING.scene((8, 8, 8)), (1.0, 2.0, 2.0))
    assert float(kinetic_energy(state)) == pytest.approx(4.5)
    assert float(potential_energy(state)) == pytest.approx(9.81 * 0.3, rel=1e-6)
    up = with_scene(state, gravity=-torch.tensor([GRAVITY]))
    height = float(state.scene.domain_upper[0, 1]) - 0.3
    assert float(potential_energy(up)) == pytest.approx(9.81 * height, rel=1e-5)


def course(start: Particles, *changes: tuple[float, float, float]) -> Iterator[Particles]:
    """Yield states whose speeds and heights are those of the start and more."""
    for speed, height, lost in changes:
        position, velocity = start.position.clone(), start.velocity.clone()
        velocity[:, 0] += speed
        position[:, 1] += height
        if lost:
            position[0, 0] = torch.nan
        yield start.moved(position, velocity)


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        (((0.0, 0.0, 0.0), (0.1, -0.02, 0.0)), "stable"),
        (((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)), "degrades"),  # energy rises
        (((0.0, 0.0, 0.0), (0.0, -2.0, 0.0)), "blows up"),  # all are below the floor
        (((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), "blows up"),  # not finite
        (((100.0, 0.0, 0.0), (0.0, 0.0, 0.0)), "blows up"),  # for one step
        (((0.0, 0.0, 0.0),), "blows up"),  # ends early
    ],
)
def test_the_verdict(changes: tuple[tuple[float, float, float], ...], verdict: str) -> None:
    start = dam(SETTING)
    found = judge(start, course(start, *changes), 2, closed=False)
    assert found.verdict == verdict
    finite = [lost for _, _, lost in changes].index(1.0) if changes[-1][2] else len(changes)
    assert found.survived == finite


def test_escaped_particles_and_drifts_are_measured() -> None:
    start = dam(SETTING)
    position = start.position.clone()
    position[:100, 0] -= 1.0
    found = judge(start, [start.moved(position, start.velocity)], 1, closed=False)
    assert found.verdict == "degrades" and found.escaped == pytest.approx(0.1)
    pair = next(it for it in cases(SETTING, 1, 1, 0) if it.closed).make()
    pushed = pair.moved(pair.position, pair.velocity + torch.tensor([0.1, 0.0, 0.0]))
    assert judge(pair, [pushed], 1, closed=True).momentum == pytest.approx(0.1, rel=1e-3)
    assert judge(pair, [pair], 1, closed=True).momentum == 0


def test_a_case_that_raises_is_a_reason() -> None:
    start = dam(SETTING)

    def states() -> Iterator[Particles]:
        yield start
        raise ValueError("no more")

    found = judge(start, states(), 2, closed=False)
    assert (found.verdict, found.reason) == ("fails", "ValueError: no more")


def test_what_a_model_says_in_use() -> None:
    model = load("box_drops")
    assert says_of(model, dam(SETTING)) == ""
    slower = dam(replace(SETTING, time_step=0.04))
    assert says_of(model, slower).startswith("refused: This prior is set for a time step of 0.02 s")
    thick = dam(replace(SETTING, viscosity=1.0))
    assert "has a viscosity of 1, and steps of 3.33 ms" in says_of(model, thick)
    # What it warns of is true.
    for viscosity, verdict in ((0.09, "stable"), (0.2, "blows up")):
        start = dam(replace(SETTING, viscosity=viscosity))
        found = judge(start, model_states(model, start, 40, lambda: None), 40, closed=False)
        assert found.verdict == verdict
        assert bool(says_of(model, start)) == (verdict != "stable")


@pytest.mark.parametrize("name", ["box_drops", "dam_break_small"])
def test_a_shipped_model_is_stable_where_it_should_be(name: str) -> None:
    model = load(name)
    for case in cases(SETTING, 60, 150, 0):
        if case.expected:
            assert run_case(case, model, lambda: None)["model"].verdict == "stable", case.name


def test_momentum_stays_where_nothing_acts_from_outside() -> None:
    case = next(it for it in cases(SETTING, 40, 1, 0) if it.closed)
    found = run_case(case, load("box_drops"), lambda: None)["model"]
    assert found.momentum < 1e-5 and found.verdict == "stable"


def test_a_network_is_run_beside_its_prior() -> None:
    model = build(CONFIGS / "corrected.yaml", (4, 4, 4)).model.eval()
    prior = prior_of(model)
    assert prior is not None and prior.network.target.width == 0
    case = next(it for it in cases(SETTING, 2, 2, 0) if it.name == "dam break")
    assert run_case(case, model, lambda: None).keys() == {"model", "prior"}
    assert prior_of(load("box_drops")) is None and prior_of(Model((2, 2, 2)).eval()) is None


def test_precision_and_growth() -> None:
    model, start = load("box_drops"), dam(SETTING)
    rows = {str(row[0]): row[1:] for row in precision_rows(model, start, 10)}
    assert 0 < float(rows["float32"][0]) < 1e-4 < float(rows["bfloat16"][0])
    grown = growth_rows(
        lambda noise: model_states(model, moved(start, noise), 10, lambda: None), start, 10
    )
    first = [float(row[1]) for row in grown]
    assert first == sorted(first) and first[-1] == pytest.approx(0.016, rel=0.5)


def test_the_study(tmp_path: Path, real_solver: None, capsys: pytest.CaptureFixture[str]) -> None:
    main(
        [
            *("stress", "--run=box_drops", f"--output={tmp_path}", "--steps=20", "--threads=1"),
            *("--rest_steps=20", "--solver_steps=5", "--cases=[dam break,no fluid,x 8,sheet]"),
        ]
    )
    text = (tmp_path / "stress.md").read_text()
    assert text in capsys.readouterr().out
    with (tmp_path / "stress.csv").open() as file:
        rows = {(row["case"], row["by"]): row for row in csv.DictReader(file)}
    assert {case for case, _ in rows} == {
        *("dam break", "no fluid", "time step x 8", "sheet, one particle thick")
    }
    model, solver = rows["dam break", "model"], rows["dam break", "solver"]
    assert model["verdict"] == solver["verdict"] == "stable" and solver["steps"] == "5"
    assert rows["time step x 8", "model"]["in use"] == "refused"
    assert (tmp_path / "stress.png").stat().st_size > 5_000


def test_the_callback(sample: Path, tmp_path: Path) -> None:
    module, source = FluidsNet((4, 4, 4)), data(sample)
    runner = trainer(tmp_path, max_steps=2, callbacks=[OneStepTable(), StressCases(2, 3)])
    runner.fit(module, source)
    runner.test(module, source, verbose=False)
    (path,) = tmp_path.rglob("stress.csv")
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(cases(SETTING, 1, 1, 0)) and {row["by"] for row in rows} == {"model"}
    with pytest.raises(UserError, match="StressCases: steps is 0; set at least 1"):
        StressCases(0)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--radius=0", "--radius is 0.0; set it above zero."),
        ("--viscosity=-1", "--viscosity is -1.0; set at least 0."),
        ("--cases=[nothing]", "no case has one of these words"),
        ("--run=runs/nowhere", "runs/nowhere"),
    ],
)
def test_options_that_cannot_be_used(
    option: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["stress", "--run=box_drops", "--solver=null", option])
    assert message in capsys.readouterr().err
