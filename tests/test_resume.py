"""A run that is killed and resumed ends with the weights of the undisturbed run."""

from __future__ import annotations

import random
import time
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from fluidsnet.main import main
from tools.processes import started

CONFIGS = Path(__file__).parents[1] / "configs"
STEPS = 34


def overlay(folder: Path, every: str) -> Path:
    """Write a config that saves best.ckpt at each validation and last.ckpt at each step or such."""
    checkpoint = "lightning.pytorch.callbacks.ModelCheckpoint"
    shared = {"enable_version_counter": False}
    best = {"filename": "best", "monitor": "val/skill", "mode": "max", **shared}
    last = {"filename": "last", every: 1, **shared}
    callbacks = [{"class_path": checkpoint, "init_args": it} for it in (best, last)]
    path = folder / "overlay.yaml"
    path.write_text(yaml.safe_dump({"trainer": {"callbacks": callbacks}}))
    return path


def options(model: str, overlay: Path, sample: Path, folder: Path, workers: int) -> list[str]:
    """Return the arguments of a fit in a folder."""
    configs = (
        CONFIGS / "trainer.yaml",
        CONFIGS / "model" / model,
        CONFIGS / "data" / "sample.yaml",
    )
    return [
        "fit",
        *(f"--config={path}" for path in (*configs, overlay)),
        *(f"--data.init_args.root={sample}", f"--data.init_args.workers={workers}"),
        *("--data.init_args.batch_size=2", "--data.init_args.sample_every=4"),
        "--data.init_args.augmentation=datamodules.augmentation.BoxSymmetry",
        "--model.init_args.noise=fluidsnet.noise.StartNoise",
        *("--trainer.max_epochs=-1", f"--trainer.max_steps={STEPS}"),
        *("--trainer.limit_val_batches=2", "--trainer.val_check_interval=4"),
        *("--trainer.check_val_every_n_epoch=1", "--trainer.enable_progress_bar=false"),
        f"--trainer.logger.init_args.save_dir={folder}",
        *("--trainer.logger.init_args.name=run", "--trainer.logger.init_args.version="),
    ]


def train(arguments: list[str], last: Path, saves: int | None, delay: float = 0.0) -> bool:
    """Fit in a process of its own; return whether it came to its end.

    Args:
        arguments: Command and options.
        last: Checkpoint that is written at each step.
        saves: Number of writes of it after which the process is killed; None for none.
        delay: Time from the last of them to the kill, s.
    """
    seen, found = 0, last.stat().st_mtime_ns if last.exists() else 0
    with started(arguments, last.parents[2].with_suffix(".txt")) as process:
        deadline = time.monotonic() + 300
        while process.is_alive():
            assert time.monotonic() < deadline
            written = last.stat().st_mtime_ns if last.exists() else 0
            seen, found = seen + (written != found), written
            if saves is not None and seen >= saves:
                time.sleep(delay)
                process.kill()
            time.sleep(0.002)
        process.join()
        assert process.exitcode in (0, -9)
        return process.exitcode == 0


def weights(path: Path) -> dict[str, Any]:
    """Return the weights of a checkpoint, and the state of its optimizer's first weight."""
    saved = torch.load(path, weights_only=True)
    assert saved["global_step"] == STEPS
    return {**saved["state_dict"], "adam": saved["optimizer_states"][0]["state"][0]["exp_avg"]}


@pytest.mark.parametrize(
    ("workers", "every", "kills", "most"),
    [(0, "every_n_train_steps", 10, 3), (1, "every_n_epochs", 3, 2)],
)
def test_killed_runs_end_with_the_weights_of_the_undisturbed_one(
    workers: int, every: str, kills: int, most: int, sample: Path, tmp_path: Path
) -> None:
    checkpoint = Path("run", "checkpoints", "last.ckpt")
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    changes = overlay(tmp_path, every)
    undisturbed = options("paper.yaml", changes, sample, whole, workers)
    assert train(undisturbed, whole / checkpoint, None)
    expected = weights(whole / checkpoint)
    draws = random.Random(0)
    arguments, resume = options("paper.yaml", changes, sample, broken, workers), []
    for _ in range(kills):
        saves, delay = draws.randint(1, most), draws.uniform(0.0, 0.05)
        assert not train([*arguments, *resume], broken / checkpoint, saves, delay)
        resume = ["--ckpt_path=last"]
    assert train([*arguments, *resume], broken / checkpoint, None)
    found = weights(broken / checkpoint)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert torch.equal(found[name], value), name


def test_two_fits_of_one_seed_end_with_the_same_bits(sample: Path, tmp_path: Path) -> None:
    found = []
    for name in ("first", "second"):
        folder = tmp_path / name
        changes = overlay(tmp_path, "every_n_epochs")
        main(options("corrected.yaml", changes, sample, folder, workers=0))
        found.append(weights(folder / "run" / "checkpoints" / "last.ckpt"))
    assert all(torch.equal(value, found[1][name]) for name, value in found[0].items())


def test_another_batch_size_draws_the_epoch_anew(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = overlay(tmp_path, "every_n_train_steps")
    arguments = options("paper.yaml", changes, sample, tmp_path, workers=0)
    main([*arguments, "--trainer.max_steps=3"])
    with pytest.warns(UserWarning, match="the samples of its epoch are drawn anew"):
        main([*arguments, "--ckpt_path=last", "--data.init_args.batch_size=3"])
    assert weights(tmp_path / "run" / "checkpoints" / "last.ckpt")
