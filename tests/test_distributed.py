"""Tests that several processes train, measure and roll out as one process does."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from shared_fit import SPLITS, STEPS, fit, rows_of
from torch import nn

ROOT = Path(__file__).parents[1]
RESULTS = Path("run") / "results" / "data"


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the folders that `shared_fit` writes with one process and with two."""
    folder = tmp_path_factory.mktemp("processes")
    data, one, two = (folder / name for name in ("data", "one", "two"))
    for path in (data, one, two):
        path.mkdir()
    sample = ROOT / "tests" / "data" / "dam_break"
    # Three simulations to test on, which two processes cannot share alike.
    for split, source in (("train", "train"), ("val", "val"), ("test", "train")):
        shutil.copy(sample / f"{source}.h5", data / f"{split}.h5")
    program = [sys.executable, str(ROOT / "tests" / "shared_fit.py"), str(data), str(two), "2"]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    ended = subprocess.run(
        program, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": path}
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    fit(data, one, processes=1)
    return one, two


def test_two_processes_train_as_one_with_twice_the_batch(folders: tuple[Path, Path]) -> None:
    one = torch.load(folders[0] / "process_0.pt")
    assert any(name.startswith("models.acceleration.") for name in one["weights"])
    two = [torch.load(folders[1] / f"process_{rank}.pt") for rank in range(2)]
    # Particles of the two differ, and so would a mean of their means.
    assert two[0]["sizes"] != two[1]["sizes"]
    assert len(one["losses"]) == STEPS
    for each in two:
        # Not bit for bit: sums over particles are taken in another order.
        assert each["losses"] == pytest.approx(one["losses"], rel=1e-5)
        for name, expected in one["weights"].items():
            off = (each["weights"][name].double() - expected.double()).norm()
            assert off <= 1e-5 * expected.double().norm(), name
            assert torch.equal(each["weights"][name], two[0]["weights"][name]), name


def test_processes_draw_other_random_numbers(folders: tuple[Path, Path]) -> None:
    first, second = (torch.load(folders[1] / f"process_{rank}.pt")["drawn"] for rank in range(2))
    assert first != second


def test_two_processes_measure_every_frame_once(folders: tuple[Path, Path]) -> None:
    one, two = (json.loads((folder / "metrics.json").read_text()) for folder in folders)
    assert {"val/loss", "val/skill", "test/model/velocity_mse"} <= one.keys()
    assert {"rollout/position_error_mm/2", "rollout/density_error/2"} <= one.keys()
    assert {"ablation/skill/acceleration", "test/acceleration/velocity_mse"} <= one.keys()
    for name, expected in one.items():
        assert two[name] == pytest.approx(expected, rel=1e-4), name


def test_fewer_samples_than_processes_are_refused(folders: tuple[Path, Path]) -> None:
    said = torch.load(folders[1] / "process_0.pt")["refusal"]
    assert said.startswith("There are 2 processes and only 1 samples or simulations")


@pytest.mark.parametrize(
    "table",
    ["one_step", "rollout_metrics", "rollout_metrics_predict", "global_feature_permutation"],
)
def test_two_processes_write_the_same_tables(folders: tuple[Path, Path], table: str) -> None:
    one, two = (
        list(csv.reader((folder / RESULTS / f"{table}.csv").read_text().splitlines()))
        for folder in folders
    )
    for row, expected in zip(two[1:], one[1:], strict=True):
        for cell, number in zip(row, expected, strict=True):
            assert cell == number or float(cell) == pytest.approx(float(number), rel=1e-4)


def test_two_processes_write_every_rollout(folders: tuple[Path, Path]) -> None:
    for folder in folders:
        names = [path.name for path in sorted((folder / RESULTS / "rollouts").iterdir())]
        assert names == ["00000.vtkhdf", "00001.vtkhdf", "00002.vtkhdf"]
        assert (folder / RESULTS / "rollout.png").exists()


def test_batch_norm_and_loss_of_two_processes_are_those_of_one(
    folders: tuple[Path, Path],
) -> None:
    results = (torch.load(folders[1] / f"process_{rank}.pt")["shared"] for rank in range(2))
    cases = zip(*results, strict=True)
    for split, both in zip(SPLITS, cases, strict=True):
        rows, gradient = rows_of(split)
        norm = nn.BatchNorm1d(3).train(len(rows) > 1)
        own = rows.clone().requires_grad_()
        expected = norm(own)
        expected.backward(gradient)
        result, own_grad, weight_grad, states, losses = zip(*both, strict=True)
        assert norm.weight.grad is not None and own.grad is not None
        assert torch.allclose(torch.cat(result), expected, atol=1e-4), split
        assert torch.allclose(torch.cat(own_grad), own.grad, atol=1e-4), split
        assert torch.allclose(sum(weight_grad), norm.weight.grad, atol=1e-3), split
        for state in states:
            for name in ("running_mean", "running_var"):
                assert torch.allclose(state[name], norm.state_dict()[name], rtol=1e-5), split
        if len(rows):
            assert sum(losses) / 2 == pytest.approx(float((rows - gradient).square().mean()))
