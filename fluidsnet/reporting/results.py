"""Results folders: what a run measured, one folder for each data set it was measured on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

from lightning import Trainer

from fluidsnet.reporting.run_folder import run_folder

#: Folder in a run's folder that holds the results folders.
RESULTS = "results"
#: File in a results folder that notes the data: path, file hash, frames and stride.
DATA_FILE = "data.json"


def results_folder(trainer: Trainer) -> Path:
    """Return the folder for results on the trainer's data, and note there what the data are.

    It is ``results/<name of the data folder>`` in the run's folder. Data of the same name that
    differ in file hash, frames or stride get a number behind the name. All processes must
    call it together, as in a callback's ``setup``.

    Args:
        trainer: Trainer whose data module has `identity`; without one the run's folder is
            returned.
    """
    run = run_folder(trainer)
    data: Any = getattr(trainer, "datamodule", None)
    if not hasattr(data, "identity"):
        return run
    folder = _claim(run / RESULTS, data.identity("test")) if trainer.is_global_zero else None
    shared: Any = trainer.strategy.broadcast(folder)
    return Path(shared)


def results_folders(run: Path) -> dict[Path, dict[str, Any]]:
    """Return the results folders of a run and what each notes of its data, in order of names.

    A run from before results were kept apart has its tables in its own folder; that folder is
    then the first, with an empty note.

    Args:
        run: Folder of the run.
    """
    found: dict[Path, dict[str, Any]] = {}
    if any(run.glob("one_step.csv")) or any(run.glob("rollout*.csv")):
        found[run] = {}
    for folder in sorted((run / RESULTS).glob("*/")):
        found[folder] = _note(folder) or {}
    return found


def _claim(results: Path, identity: Mapping[str, Any]) -> Path:
    name = Path(identity["root"]).name or "data"
    text = json.dumps(identity, indent=2)
    folders = (results / (name if number == 1 else f"{name}_{number}") for number in count(1))
    folder = next(folder for folder in folders if _is_same(_note(folder), json.loads(text)))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / DATA_FILE).write_text(f"{text}\n", "utf-8")
    return folder


def _is_same(note: dict[str, Any] | None, identity: dict[str, Any]) -> bool:
    """Return whether a folder is free or holds results on the same data, wherever these lie."""
    return note is None or {**note, "root": ""} == {**identity, "root": ""}


def _note(folder: Path) -> dict[str, Any] | None:
    """Return what a results folder notes of its data; None where it notes nothing."""
    try:
        note = json.loads((folder / DATA_FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return note if isinstance(note, dict) else None
