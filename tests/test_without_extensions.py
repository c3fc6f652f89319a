"""Models and commands in a process without torch-cluster and torch-scatter."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import fluidsnet
from datamodules import read_state
from fluidsnet.rollout import rollout

ROOT = Path(__file__).parents[1]
OLD = ROOT / "tests" / "data" / "old_run"
# Imports neither; what follows is the test's own.
REFUSING = """
import sys
from importlib.abc import MetaPathFinder

class Refusing(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in ("torch_cluster", "torch_scatter"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refusing())
"""
SENTENCE = (
    "This needs the package torch-{}, which cannot be loaded (No module named 'torch_{}'); run "
    "`make setup` in a checkout, or `pip install torch-cluster torch-scatter --no-build-isolation`."
)


def without(program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Runs a program in a process that cannot import the two packages."""
    command = [sys.executable, "-c", REFUSING + program, *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, capture_output=True, text=True)


def fluidsnet_without(*arguments: object) -> subprocess.CompletedProcess[str]:
    return without("from fluidsnet.main import main; main(sys.argv[1:])", *arguments)


@pytest.mark.parametrize("run", ["box_drops", OLD], ids=["shipped", "paper"])
def test_models_roll_out_on_the_cpu_as_with_the_packages(
    run: str | Path, sample: Path, tmp_path: Path
) -> None:
    program = """
import torch, fluidsnet
from datamodules import read_state
from fluidsnet.rollout import rollout
torch.set_num_threads(1)
state = read_state(sys.argv[2], 0.02)
states = list(rollout(fluidsnet.load(sys.argv[1]), state, 5))
torch.save([(state.position, state.velocity) for state in states], sys.argv[3])
"""
    path = tmp_path / "states.pt"
    done = without(program, run, sample / "test.h5", path)
    assert done.returncode == 0, done.stderr
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    states = rollout(fluidsnet.load(run), read_state(sample / "test.h5", 0.02), 5)
    found = torch.load(path, weights_only=True)
    for (position, velocity), state in zip(found, states, strict=True):
        assert torch.equal(position, state.position) and torch.equal(velocity, state.velocity)
    torch.set_num_threads(threads)


def test_a_shipped_model_is_tested_and_predicts(sample: Path, tmp_path: Path) -> None:
    options = [
        "--run=box_drops",
        f"--data.init_args.root={sample}",
        "--data.init_args.stride=1",
        "--data.init_args.rollout_steps=2",
        "--data.init_args.workers=0",
        f"--trainer.logger.init_args.save_dir={tmp_path}",
        "--trainer.logger.init_args.name=run",
    ]
    program = """
from fluidsnet.main import main
for command in ("test", "predict"):
    main([command, *sys.argv[1:]])
"""
    done = without(program, *options)
    assert done.returncode == 0, done.stderr
    results = tmp_path / "run" / "results" / "dam_break"
    assert "chamfer" in (results / "rollout_metrics.md").read_text()
    assert (results / "rollout_metrics_predict.md").exists()


def test_training_the_papers_network_says_what_it_needs(sample: Path, tmp_path: Path) -> None:
    done = fluidsnet_without(
        "fit",
        *(f"--config={ROOT}/configs/{name}.yaml" for name in ("trainer", "model/paper")),
        f"--config={ROOT}/configs/data/sample.yaml",
        f"--data.init_args.root={sample}",
        "--data.init_args.workers=0",
        "--trainer.max_steps=1",
        "--trainer.limit_val_batches=1",
        f"--trainer.logger.init_args.save_dir={tmp_path}",
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == f"fluidsnet: {SENTENCE.format('scatter', 'scatter')}"


def test_the_search_of_torch_cluster_says_what_it_needs(sample: Path) -> None:
    program = """
from datamodules import read_state
from fluidsnet.errors import UserError
from fluidsnet.neighbors import TorchCluster
try:
    TorchCluster()(read_state(sys.argv[1], 0.02))
except UserError as error:
    print(error)
"""
    done = without(program, sample / "test.h5")
    assert done.stdout.strip() == SENTENCE.format("cluster", "cluster"), done.stderr


def test_the_doctor_names_the_packages_that_cannot_be_loaded() -> None:
    done = fluidsnet_without("doctor")
    assert done.returncode == 0
    (line,) = (it for it in done.stdout.splitlines() if it.startswith("extensions"))
    assert "torch-cluster cannot be loaded (No module named 'torch_cluster')" in line
