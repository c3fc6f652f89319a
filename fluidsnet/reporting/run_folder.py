"""Folder of a run."""

from __future__ import annotations

from pathlib import Path

from lightning import Trainer


def run_folder(trainer: Trainer) -> Path:
    """Return the folder of the trainer's logger, or its root folder without a logger.

    All processes must call it together, as in a callback's ``setup``.
    """
    return Path(trainer.log_dir or trainer.default_root_dir)
