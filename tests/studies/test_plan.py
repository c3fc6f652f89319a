"""``fluidsnet inspect --model``: parts, weights and costs of a model on a scene."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import pytest
import torch

from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.main import main
from fluidsnet.models import load
from fluidsnet.models.loading import build
from fluidsnet.studies.plan.command import describe_plan
from fluidsnet.studies.plan.costs import measure_costs
from fluidsnet.studies.plan.parts import parts_of

CONFIGS = Path(__file__).parents[2] / "configs" / "model"


def rows(text: str) -> dict[str, list[str]]:
    """Return the words of each row of a plan by the name of its part."""
    _, _, table = text.partition("\n\n")
    found = {}
    for line in table.splitlines()[1:]:
        name, _, rest = line.partition("  ")
        found[name] = rest.split()
    return found


def test_the_plan_of_the_papers_network(sample: Path) -> None:
    text = describe_plan(str(CONFIGS / "paper.yaml"), sample / "test.h5")
    with h5py.File(sample / "test.h5") as file:
        name = next(iter(file))
        fluid, solid = file[name]["position"].shape[1], len(file[name]["solid_position"])
    assert f"particles stored    {fluid:,} fluid, {solid:,} solid" in text
    parts = rows(text)
    assert parts["prior"][:2] == ["left", "out"] and "FreeFall" in parts["prior"][2]
    assert parts["walls as planes"][:2] == ["left", "out"]
    assert parts["solids"][0] == parts["third axis"][0] == parts["neighbor search"][0] == "built"
    # NeighborMean of Table 1: 7·7 + 7 weights and 7·9 + 9.
    assert "128" in parts["local feature"]


def test_weights_are_all_counted(sample: Path) -> None:
    for name in ("paper", "corrected", "field"):
        model = build(CONFIGS / f"{name}.yaml", (4, 4, 4)).model.eval()
        reader = FrameReader(sample / "test.h5")
        state = reader.state(next(iter(reader.frames)), 0, 1)
        parts = parts_of(model, state, 0)
        assert sum(part.weights or 0 for part in parts) == sum(
            weight.numel() for weight in model.parameters()
        )


def test_what_a_scene_does_not_have_is_left_out(sample: Path, tmp_path: Path) -> None:
    reader = FrameReader(sample / "test.h5")
    state = reader.state(next(iter(reader.frames)), 0, 1)
    model = load("box_drops")

    def built(particles: object) -> set[str]:
        return {part.name for part in parts_of(model, particles, 0) if part.built}  # type: ignore[arg-type]

    everything = built(state.with_solids(state.solid_position, state.solid_velocity))
    assert everything - built(state) == {"motion of solids"}
    none = state.solid_position[:0]
    alone = replace(
        state, solid_position=none, solid_velocity=none, solid_frame=state.solid_frame[:0]
    )
    assert built(state) - built(alone) == {"solids"}
    flat = replace(state, scene=replace(state.scene, dimension=2))
    assert built(state) - built(flat) == {"third axis"}


def test_costs_are_of_each_part(sample: Path) -> None:
    reader = FrameReader(sample / "test.h5")
    state = reader.state(next(iter(reader.frames)), 0, 1)
    torch.manual_seed(0)
    network = build(CONFIGS / "corrected.yaml", (4, 4, 4)).model.eval()
    costs = measure_costs(network, state, repeats=2)
    assert costs.keys() == {"prior", "inputs", "local", "global", "head", "motion", "step"}
    assert all(cost.seconds > 0 and cost.bytes >= 0 for cost in costs.values())
    assert measure_costs(load("box_drops"), state, repeats=1).keys() == {"prior", "motion", "step"}


def test_a_model_that_varies_has_the_inputs(sample: Path, tmp_path: Path) -> None:
    shutil.copy(sample / "train.h5", tmp_path / "train.h5")
    with h5py.File(tmp_path / "train.h5", "r+") as file:
        for number, name in enumerate(file):
            file[name].attrs["viscosity"] = 0.01 * (number + 1)
    parts = rows(describe_plan(str(CONFIGS / "paper.yaml"), tmp_path / "train.h5"))
    assert parts["viscosity"][:2] == ["built", "varies"]
    parts = rows(describe_plan(str(CONFIGS / "corrected.yaml"), tmp_path / "train.h5"))
    assert "prior" in parts["viscosity"]
    assert parts["gravity"][0] == "built" and parts["surface tension"][0] == "left"


def test_bad_input_is_one_sentence(sample: Path, capsys: pytest.CaptureFixture[str]) -> None:
    box_drops = ["--model", "box_drops", "--data", str(sample / "test.h5")]
    for arguments, words in (
        ([], "name a data file"),
        (["--model", "box_drops"], "--model needs the file of a scene"),
        ([*box_drops, "--stride", "2"], "prior is set for a time step of 0.02 s"),
        ([*box_drops, "--frame", "99999"], "there is no frame 99999"),
    ):
        with pytest.raises(SystemExit):
            main(["inspect", *arguments])
        assert words in capsys.readouterr().err
    with pytest.raises(UserError, match="is not the folder of a run"):
        describe_plan("nothing", sample / "test.h5")
