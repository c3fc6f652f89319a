"""Results folders: what a run measured, one folder for each data set it was measured on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

from lightning import Trainer

from fluidsnet.errors import UserError
from fluidsnet.reporting.run_folder import run_folder
from fluidsnet.whole_file import write_whole

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

    Raises:
        UserError: The data cannot be read, or the folder cannot be written.
    """
    run = run_folder(trainer)
    data: Any = getattr(trainer, "datamodule", None)
    if not hasattr(data, "identity"):
        return run
    folder: Path | UserError | None = None
    if trainer.is_global_zero:
        try:
            folder = _claim(run / RESULTS, data.identity("test"))
        except UserError as error:
            folder = error
        except OSError as error:
            folder = UserError(f"{run / RESULTS} cannot be written: {error.strerror}.")
    # Also an error is shared: the other processes wait for it.
    shared: Any = trainer.strategy.broadcast(folder)
    if isinstance(shared, UserError):
        raise shared
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
    name = Path(identity["root"]).resolve().name or "data"
    text = json.dumps(identity, indent=2)
    folders = (results / (name if number == 1 else f"{name}_{number}") for number in count(1))
    folder = next(folder for folder in folders if _is_free(folder, json.loads(text)))
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / DATA_FILE, f"{text}\n")
    return folder


def _is_free(folder: Path, identity: dict[str, Any]) -> bool:
    """Return whether a folder is empty or holds results on the same data, wherever these lie."""
    if not (folder / DATA_FILE).exists():
        return True
    note = _note(folder)
    return note is not None and {**note, "root": ""} == {**identity, "root": ""}


def _note(folder: Path) -> dict[str, Any] | None:
    """Return what a results folder notes of its data; None where it notes nothing."""
    try:
        note = json.loads((folder / DATA_FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return note if isinstance(note, dict) else None
