"""Where a run leaves its files."""

from __future__ import annotations

from pathlib import Path

from lightning import Trainer


def run_folder(trainer: Trainer) -> Path:
    """The logger's folder of this run, or the trainer's root folder where nothing is logged."""
    return Path(trainer.log_dir or trainer.default_root_dir)


def rollout_file(trainer: Trainer, simulation: str) -> Path:
    """The trajectory of the rollout of a simulation."""
    return run_folder(trainer) / "rollouts" / f"{simulation}.vtkhdf"
