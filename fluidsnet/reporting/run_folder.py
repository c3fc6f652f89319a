"""Where a run leaves its files."""

from __future__ import annotations

from pathlib import Path

from lightning import Trainer


def run_folder(trainer: Trainer) -> Path:
    """The logger's folder of this run, or the trainer's root folder where nothing is logged.

    Processes agree on it: all must ask together, as in a callback's ``setup``, or it hangs.
    """
    return Path(trainer.log_dir or trainer.default_root_dir)


def rollout_file(folder: Path, simulation: str) -> Path:
    """The trajectory of the rollout of a simulation in a run's folder."""
    return folder / "rollouts" / f"{simulation}.vtkhdf"
