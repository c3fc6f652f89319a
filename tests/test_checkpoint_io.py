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


class Command:
    """An object that makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def test_it_writes_and_reads(tmp_path: Path) -> None:
    path = tmp_path / "new" / "last.ckpt"
    WholeCheckpoints().save_checkpoint({"step": 3, "w": torch.ones(2)}, path)
    read = WholeCheckpoints().load_checkpoint(path)
    assert read["step"] == 3 and torch.equal(read["w"], torch.ones(2))
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
    assert WholeCheckpoints().load_checkpoint(path)["w"].shape == (10,)
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
