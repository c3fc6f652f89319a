"""The fit of a prior's numbers to frames of the real solver."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch
import yaml

import fluidsnet
from datamodules.reader import FrameReader
from fluidsnet.main import main
from fluidsnet.studies.tune.objective import Errors, Objective

PRIOR = Path(__file__).parents[2] / "configs" / "model" / "prior.yaml"


def tune(sample: Path, output: Path, *more: str) -> None:
    files = [f"--data={sample / 'train.h5'}", f"--model={PRIOR}", f"--output={output}"]
    words = ["--simulations=1", "--samples=4", "--steps=10", "--threads=1"]
    main(["tune", *files, *words, *more])


def test_the_errors_are_those_of_the_models_steps(sample: Path) -> None:
    reader, model = FrameReader(sample / "test.h5"), fluidsnet.load(PRIOR)
    name = next(iter(reader.frames))
    found = Objective(reader, [name], samples=1, steps=3, stride=2)(model)
    first = reader.frames[name] - 1 - 4
    one = model.step(reader.state(name, first, 2))
    two = model.step(one)
    position, velocity = reader.fluid(name, first + 2)
    assert found.one_step == pytest.approx(float((one.position - position).norm(dim=1).mean()))
    later = reader.fluid(name, first + 4)[0]
    assert found.two_steps == pytest.approx(float((two.position - later).norm(dim=1).mean()))
    square = (one.velocity - velocity).square().sum(dim=1).mean()
    assert found.velocity == pytest.approx(float(square.sqrt()))
    state = reader.state(name, 0, 2)
    for _ in range(3):
        state = model.step(state)
    end = reader.fluid(name, 6)[0]
    assert found.rollout == pytest.approx(float((state.position - end).norm(dim=1).mean()))
    # Twice the error in all of them adds log 2.
    doubled = Errors(*(2 * it for it in vars(found).values()))
    assert doubled.score - found.score == pytest.approx(float(torch.tensor(2.0).log()))


def test_a_fit_lowers_the_score_and_its_config_is_a_prior(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tune(sample, tmp_path, "--numbers=[relaxation,warm_start]", "--evaluations=12")
    assert "after" in capsys.readouterr().out
    with (tmp_path / "tune.csv").open() as file:
        rows = list(csv.DictReader(file))
    scores = [float(row["score"]) for row in rows]
    assert len(rows) == 12 and min(scores) < scores[0]
    written = yaml.safe_load((tmp_path / "prior.yaml").read_text())
    before = yaml.safe_load(PRIOR.read_text())
    numbers = written["model"]["init_args"]["prior"]["init_args"]
    best = rows[scores.index(min(scores))]
    for name in ("relaxation", "warm_start"):
        assert numbers.pop(name) == pytest.approx(float(best[name]), abs=1e-3)
        assert 0 <= float(best[name]) <= 1
    # Nothing else changes, the cost least of all.
    assert written == before
    model = fluidsnet.load(tmp_path / "prior.yaml")
    assert model.prior.relaxation == pytest.approx(float(best["relaxation"]), abs=1e-3)


def test_a_prior_that_blows_up_has_a_finite_score() -> None:
    assert Errors(*[float("inf")] * 4).score > Errors(*[1.0] * 4).score
    assert Errors(*[float("inf")] * 4).score < 100


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--numbers=[]", "--numbers is empty"),
        ("--numbers=[sweep]", "PressureStep has no number 'sweep' to fit; it has"),
        ("--evaluations=0", "--evaluations is 0; it must be at least 1."),
        ("--stride=10000", "has no simulation of two steps; set a lower --stride."),
        ("--model=configs/model/corrected.yaml", "describes a network without weights"),
    ],
)
def test_options_that_cannot_be_used(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, message: str
) -> None:
    with pytest.raises(SystemExit):
        tune(sample, tmp_path / "out", option)
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
