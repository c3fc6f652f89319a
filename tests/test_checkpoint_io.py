"""Checkpoint files: whole or not there, and without objects that run code."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from lightning import Trainer
from test_module import data, trainer

from fluidsnet import FluidsNet
from fluidsnet.checkpoint_io import WholeCheckpoints
from fluidsnet.errors import UserError
from fluidsnet.main import main

CONFIGS = [
    f"--config={Path(__file__).parents[1] / 'configs' / name}"
    for name in ("trainer.yaml", "model/paper.yaml", "data/sample.yaml")
]


class Command:
    """An object that makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def test_it_writes_and_reads(tmp_path: Path) -> None:
    path = tmp_path / "new" / "last.ckpt"
    saved = {"pytorch-lightning_version": "2", "step": 3, "state_dict": {"models.w": torch.ones(2)}}
    WholeCheckpoints().save_checkpoint(saved, path)
    read = WholeCheckpoints().load_checkpoint(path)
    assert read["step"] == 3 and torch.equal(read["state_dict"]["models.w"], torch.ones(2))
    assert [it.name for it in path.parent.iterdir()] == ["last.ckpt"]


def test_no_object_of_a_checkpoint_is_made(tmp_path: Path) -> None:
    path, made = tmp_path / "evil.ckpt", tmp_path / "made"
    torch.save({"state_dict": Command(made)}, path)
    with pytest.raises(UserError, match="holds objects other than weights"):
        WholeCheckpoints().load_checkpoint(path)
    with pytest.raises(UserError, match="holds objects other than weights"):
        WholeCheckpoints().load_checkpoint(path, weights_only=False)
    assert not made.exists()


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("https://example.org/best.ckpt", "is an address; download the file and name that"),
        ("nowhere.ckpt", "there is no such file"),
    ],
)
def test_what_is_no_file(path: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        WholeCheckpoints().load_checkpoint(path)


def test_a_truncated_file(tmp_path: Path) -> None:
    path = tmp_path / "half.ckpt"
    WholeCheckpoints().save_checkpoint({"w": torch.ones(1000)}, path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(UserError, match=r"half.ckpt cannot be read; it is damaged"):
        WholeCheckpoints().load_checkpoint(path)


_FULL = """
import resource, signal, sys, torch
from fluidsnet.checkpoint_io import WholeCheckpoints
from fluidsnet.errors import UserError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
try:
    WholeCheckpoints().save_checkpoint({"w": torch.ones(1_000_000)}, sys.argv[1])
except UserError as error:
    print(error)
"""


def test_where_no_more_can_be_written_the_earlier_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "best.ckpt"
    WholeCheckpoints().save_checkpoint({"w": torch.zeros(10)}, path)
    ended = subprocess.run(
        [sys.executable, "-c", _FULL, str(path)], capture_output=True, text=True, check=True
    )
    assert "best.ckpt cannot be written: " in ended.stdout
    assert "; the earlier one is whole." in ended.stdout
    assert torch.load(path, weights_only=True)["w"].shape == (10,)
    assert [it.name for it in tmp_path.iterdir()] == ["best.ckpt"]
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def test_a_loss_that_is_not_finite_ends_training_with_its_last_weights(
    sample: Path, tmp_path: Path
) -> None:
    source = data(sample)
    model = FluidsNet(source.grid_shape)
    trainer(tmp_path, max_steps=1).fit(model, source)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    runner: Trainer = trainer(tmp_path, max_steps=5)
    with torch.no_grad():
        next(model.parameters())[0] = torch.inf
    with pytest.raises(
        UserError, match=r"The loss of 'model' is not finite at step 0, so training"
    ):
        runner.fit(model, source)
    with pytest.raises(UserError, match=r"A weight is not finite at step \d, so training ends"):
        runner.save_checkpoint(tmp_path / "never.ckpt")
    assert not (tmp_path / "never.ckpt").exists()
    model.load_state_dict(before)


@pytest.fixture
def trained(sample: Path, tmp_path: Path) -> Path:
    """Folder of a run of one step."""
    main(
        [
            *("fit", *CONFIGS, f"--data.init_args.root={sample}"),
            *("--trainer.max_steps=1", "--trainer.enable_progress_bar=false"),
            *("--trainer.limit_val_batches=1", f"--trainer.logger.init_args.save_dir={tmp_path}"),
            *("--trainer.logger.init_args.name=run", "--trainer.logger.init_args.version="),
        ]
    )
    return tmp_path / "run"


def test_options_that_a_checkpoint_does_not_allow_are_named(
    trained: Path, sample: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    last = trained / "checkpoints" / "last.ckpt"
    again = ["fit", f"--config={trained / 'config.yaml'}", f"--ckpt_path={last}"]
    for arguments, words in (
        (
            ["test", f"--run={trained}", "--model.init_args.head=[16,8]"],
            "do not fit model.head: of models.model.network.head.0.weight the checkpoint holds it "
            "with shape [32, 48], and this network needs [16, 48]",
        ),
        (
            ["predict", f"--run={trained}", "--model.init_args.local.init_args.width=5"],
            "do not fit model.local",
        ),
        (
            ["test", f"--run={trained}", "--model.init_args.head=[32,16,8,4]"],
            "the checkpoint holds it with shape [3, 8], and this network needs [4, 8]",
        ),
        (
            [*again, "--model.init_args.optimizer.init_args.lr=0.1"],
            "model.optimizer.init_args.lr is 0.1, and 0.003 in the checkpoint",
        ),
        (
            [*again, "--model.init_args.optimizer=torch.optim.SGD"],
            "model.optimizer is torch.optim.SGD, and torch.optim.Adam in the checkpoint",
        ),
        ([*again[:-1], "--ckpt_path=hpc"], "--ckpt_path hpc: name the file"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        said = capsys.readouterr().err
        assert ended.value.code == 1, arguments
        assert words in said and "Traceback" not in said, said


def test_options_that_may_differ_from_a_checkpoint_change(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walls = "--model.init_args.walls=fluidsnet.walls.StopAtWalls"
    steps = "--data.init_args.rollout_steps=1"
    main(["predict", f"--run={trained}", walls, steps, "--trainer.callbacks=[]"])
    assert "VelocityTarget, Euler, StopAtWalls" in capsys.readouterr().out


@pytest.mark.parametrize(
    "content", [[1], {"a": torch.ones(2)}, {"state_dict": {}, "pytorch-lightning_version": "2"}]
)
def test_the_checkpoint_of_another_program_is_named(content: Any, tmp_path: Path) -> None:
    path = tmp_path / "best.ckpt"
    torch.save(content, path)
    with pytest.raises(UserError, match="is no checkpoint of fluidsnet: it holds no weights"):
        WholeCheckpoints().load_checkpoint(path)
