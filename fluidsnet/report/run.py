"""One run, as its folder holds it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from fluidsnet.errors import UserError
from fluidsnet.report.events import PATTERN, History, read_history
from fluidsnet.report.grid import Grid, read_grid

#: The test's rollouts; what a `RolloutMetrics` with a name measured begins so, too.
ROLLED = "rollout_metrics"
#: The tables that a run's callbacks leave, and the command that has them written.
TABLES = {
    "one_step": "test",
    ROLLED: "test",
    "rollout": "predict",
    "global_feature_permutation": "test",
}
CONFIG = "config.yaml"
#: What each PNG file begins with.
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass
class Run:
    """What a run left.

    Attributes:
        name: short, and of no other run of the report.
        folder: of the run.
        config: its configuration; None where there is none that can be read.
        config_text: the same as it is in the file.
        history: of its training.
        tables: those that are there, by their names: of `TABLES`, and further ones that begin with
            `ROLLED`.
        remarks: sentences below a table in its Markdown, by the table's name.
        pictures: PNG files in the folder.
        unread: sentences, one for each file that is not whole or cannot be read.
    """

    name: str
    folder: Path
    config: dict[str, Any] | None = None
    config_text: str = ""
    history: History = field(default_factory=History)
    tables: dict[str, Grid] = field(default_factory=dict)
    remarks: dict[str, list[str]] = field(default_factory=dict)
    pictures: list[Path] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)


def read_runs(folders: list[Path]) -> list[Run]:
    """Reads what runs left.

    Raises:
        UserError: a folder is not one of a run, or is named twice.
    """
    for folder in folders:
        _check(folder)
    places = [folder.resolve() for folder in folders]
    for number, place in enumerate(places):
        if place in places[:number]:
            raise UserError(f"{folders[number]} is named twice.")
    return [_read(folder, name) for folder, name in zip(folders, names(places), strict=True)]


def names(places: list[Path]) -> list[str]:
    """The shortest ends of the paths that tell them apart; ``version_0`` alone says nothing.

    Args:
        places: absolute, and each another.
    """
    shortest = 2 if any(place.name.startswith("version_") for place in places) else 1
    for length in range(shortest, max(len(place.parts) for place in places) + 1):
        ends = ["/".join(place.parts[-length:]) for place in places]
        if len(set(ends)) == len(ends):
            break
    return ends


def _check(folder: Path) -> None:
    if not folder.is_dir():
        raise UserError(f"{folder} is not the folder of a run: there is no such folder.")
    known = (CONFIG, PATTERN, *(f"{table}.csv" for table in TABLES))
    if not any(path for pattern in known for path in folder.glob(pattern)):
        below = sorted(path.parent for path in folder.glob(f"*/{CONFIG}"))
        hint = f" Name a folder below it, such as {below[-1]}." if below else ""
        raise UserError(
            f"{folder} is not the folder of a run: it holds no {CONFIG}, no TensorBoard events "
            f"and no tables.{hint}"
        )


def _read(folder: Path, name: str) -> Run:
    run = Run(name, folder, history=read_history(folder))
    run.unread = [*run.history.unread]
    _read_config(run)
    further = sorted(path.stem for path in folder.glob(f"{ROLLED}_*.csv"))
    for table in (*TABLES, *further):
        path = folder / f"{table}.csv"
        if path.exists():
            try:
                run.tables[table] = read_grid(path)
            except (OSError, ValueError) as error:
                run.unread.append(f"{path.name} cannot be read: {error}.")
        run.remarks[table] = _remarks(path.with_suffix(".md"))
    for path in sorted(folder.glob("*.png")):
        if path.read_bytes()[:8] == _PNG:
            run.pictures.append(path)
        else:
            run.unread.append(f"{path.name} cannot be read: it is no PNG file.")
    return run


def _read_config(run: Run) -> None:
    path = run.folder / CONFIG
    if not path.exists():
        return
    try:
        run.config_text = path.read_text(encoding="utf-8")
        config = yaml.safe_load(run.config_text)
    except (OSError, UnicodeError, yaml.YAMLError):
        run.unread.append(f"{CONFIG} cannot be read: it is no plain YAML.")
        return
    if isinstance(config, dict):
        run.config = config
    else:
        run.unread.append(f"{CONFIG} holds no settings.")


def _remarks(path: Path) -> list[str]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeError):
        return []
    return [line for line in lines if line.strip() and not line.startswith("|")]
