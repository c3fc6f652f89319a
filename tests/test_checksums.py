"""Checksums of data files and checkpoints."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import torch

from datamodules.reader import FrameReader
from fluidsnet.checkpoint_io import WholeCheckpoints
from fluidsnet.errors import UserError
from fluidsnet.main import main


def checkpoint(value: float) -> dict[str, Any]:
    """Return what a checkpoint has to hold."""
    weights = {"models.model.w": torch.full((3,), value)}
    return {"state_dict": weights, "pytorch-lightning_version": "2.6.0"}


@pytest.fixture
def folder(sample: Path, tmp_path: Path) -> Path:
    """Return a data set with a checkpoint in a folder of it, both with checksums."""
    for name in ("train.h5", "test.h5"):
        shutil.copy(sample / name, tmp_path)
    WholeCheckpoints().save_checkpoint(checkpoint(1.0), tmp_path / "run" / "best.ckpt")
    main(["inspect", "--hash", str(tmp_path)])
    return tmp_path


def test_they_are_those_of_sha256sum(folder: Path) -> None:
    names = (folder / "SHA256SUMS").read_text().split()[1::2]
    assert names == ["test.h5", "train.h5"]
    for sums in (folder, folder / "run"):
        subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=sums, check=True)


def test_files_that_have_changed_are_not_read(folder: Path) -> None:
    FrameReader(folder / "test.h5")
    with (folder / "test.h5").open("r+b") as file:
        file.seek(-8, 2)
        file.write(b"damaged!")
    message = "test.h5 is not the file that .*SHA256SUMS describes: it is damaged, or has changed"
    with pytest.raises(UserError, match=message):
        FrameReader(folder / "test.h5")
    with pytest.raises(SystemExit):
        main(["inspect", str(folder / "test.h5")])
    FrameReader(folder / "train.h5")

    path = folder / "run" / "best.ckpt"
    WholeCheckpoints().load_checkpoint(path)
    path.write_bytes(path.read_bytes().replace(b"models.model.w", b"models.model.v"))
    with pytest.raises(UserError, match=r"best.ckpt is not the file that"):
        WholeCheckpoints().load_checkpoint(path)
    # On purpose: hashed again, beside the others.
    main(["inspect", "--hash", str(path)])
    WholeCheckpoints().load_checkpoint(path)


def test_a_training_that_goes_on_hashes_its_checkpoints(folder: Path) -> None:
    path = folder / "run" / "best.ckpt"
    WholeCheckpoints().save_checkpoint(checkpoint(0.0), path)
    weights = WholeCheckpoints().load_checkpoint(path)["state_dict"]
    assert weights["models.model.w"].sum() == 0


def test_names_with_a_folder_are_understood(folder: Path) -> None:
    sums = folder / "SHA256SUMS"
    sums.write_text(sums.read_text().replace("  ", " *./").replace("0", "1"))
    with pytest.raises(UserError, match="is not the file that"):
        FrameReader(folder / "test.h5")


def test_a_folder_without_files_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["inspect", "--hash", str(tmp_path)])
    assert "no data file or checkpoint in it" in capsys.readouterr().err
