"""Files of a run: configuration, training curves, and results on each data set."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from fluidsnet.errors import UserError
from fluidsnet.plain_yaml import read_yaml
from fluidsnet.report.events import PATTERN, History, read_history
from fluidsnet.report.tables import read_table, unique
from fluidsnet.reporting.results import DATA_FILE, results_folders

CONFIG = "config.yaml"
#: Table of rollouts; those of `predict` and of a `RolloutMetrics` with a name append to it.
ROLLED = "rollout_metrics"
PREDICTED = f"{ROLLED}_predict"
PERMUTED = "global_feature_permutation"
#: Tables of results and the commands that write them.
TABLES = {"one_step": "test", ROLLED: "test", PREDICTED: "predict", PERMUTED: "test"}
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass
class Run:
    """Contents of a run's folder."""

    name: str  # short, unique in the report
    folder: Path
    history: History
    prefix: str = ""  # of its labels, and suffix of its tables' names, among several runs
    suffix: str = ""
    config: str = ""  # text of the file; empty where it cannot be read
    settings: dict[str, str] = field(default_factory=dict)
    results: list[Results] = field(default_factory=list)  # those on the training data first
    unread: list[str] = field(default_factory=list)  # a sentence for each damaged file

    @contextmanager
    def reading(self, path: Path) -> Iterator[None]:
        """Add a sentence to `unread` if a file cannot be read."""
        try:
            yield
        except (OSError, ValueError, yaml.YAMLError) as error:
            reason: object = error
            if isinstance(error, yaml.YAMLError):
                reason = f"it is not plain YAML ({' '.join(str(error).split())})"
            self.unread.append(f"{path.relative_to(self.folder)} cannot be read: {reason}.")

    def check_inside(self, path: Path) -> None:
        """Raise a `ValueError` if a file is a link that leads out of the folder."""
        if not path.resolve().is_relative_to(self.folder.resolve()):
            raise ValueError("it is a link to a file outside the folder")


@dataclass
class Results:
    """Tables and pictures of a run on one data set."""

    run: Run
    label: str = "data not noted"  # name of the results folder
    data: dict[str, Any] = field(default_factory=dict)  # data.json; empty in old runs
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    remarks: dict[str, list[str]] = field(default_factory=dict)  # sentences below a table
    pictures: dict[str, bytes] = field(default_factory=dict)  # PNG files

    @property
    def key(self) -> str:
        """Identity of the frames, wherever the data lie; equal ones can be compared."""
        return str(sorted((k, v) for k, v in self.data.items() if k not in ("root", "file")))

    @property
    def files(self) -> list[Path]:
        """Data files; several where the data are split by frame."""
        names = str(self.data.get("file")).split(", ")
        return [Path(self.data["root"], name) for name in names] if self.data else []

    @property
    def on_training_data(self) -> bool:
        """True if the run was trained on the same data folder."""
        trained_on = Path(self.run.settings.get("data.root", ""))
        return trained_on.resolve() == Path(self.data.get("root", "")).resolve()


@dataclass
class Group:
    """Results on the same data: of the runs that have some, and of those without any at all."""

    label: str  # short name of the data; empty if the report has no other data
    members: list[Results]

    def named(self, title: str, separator: str = "_") -> str:
        """Return a title with the label behind it."""
        return f"{title}{separator}{self.label}" if self.label else title

    def of(self, run: Run) -> Results | None:
        """Return the results of a run."""
        return next((results for results in self.members if results.run is run), None)

    def tables(self, name: str) -> dict[str, pd.DataFrame]:
        """Return the tables of a name by the names of the runs."""
        return {it.run.name: it.tables[name] for it in self.members if name in it.tables}


def read_runs(folders: Sequence[Path]) -> list[Run]:
    """Read the folders of runs.

    Raises:
        UserError: A folder is not the folder of a run, or is named twice.
    """
    places = [folder.resolve() for folder in folders]
    for index, folder in enumerate(folders):
        _check(folder)
        if places[index] in places[:index]:
            raise UserError(f"{folder} is named twice.")
    runs = [_read(folder, name) for folder, name in zip(folders, names(places), strict=True)]
    for run in runs if len(runs) > 1 else ():
        run.prefix, run.suffix = f"{run.name}: ", f"_{run.name}"
    return runs


def names(places: Sequence[Path]) -> list[str]:
    """Return the shortest endings of distinct paths that are distinct, longer than `version_0`."""
    shortest = 2 if any(place.name.startswith("version_") for place in places) else 1
    endings = (["/".join(it.parts[-length:]) for it in places] for length in count(shortest))
    return next(ends for ends in endings if len(set(ends)) == len(ends))


def flat(config: Any, name: str = "") -> dict[str, str]:
    """Flatten a configuration to settings with dotted names, such as ``model.target``.

    A block is a setting with the name of its class; its arguments follow its name, as on the
    command line. Other values are JSON.
    """
    found: dict[str, str] = {}
    if isinstance(config, dict) and "class_path" in config:
        found[name] = str(config["class_path"]).rpartition(".")[2]
        config = config.get("init_args") or {}
    elif isinstance(config, list) and config and all(isinstance(it, dict) for it in config):
        blocks: dict[str, Any] = {}
        for block in config:
            kind = str(block.get("class_path")).rpartition(".")[2]
            blocks[unique(kind, blocks)] = block
        config = blocks
    if isinstance(config, dict):
        for key, value in config.items():
            found |= flat(value, f"{name}.{key}".lstrip("."))
    else:
        text = config or "''" if isinstance(config, str) else json.dumps(config, default=str)
        found[name] = text
    return found


def group_results(runs: Sequence[Run]) -> list[Group]:
    """Group the results of runs by their data; there is at least one group."""
    groups: dict[str, Group] = {}
    for results in (results for run in runs for results in run.results):
        if results.key not in groups:
            label = unique(results.label, [group.label for group in groups.values()])
            groups[results.key] = Group(label, [])
        groups[results.key].members.append(results)
    found = [*groups.values()] or [Group("", [])]
    found[0].members += [Results(run) for run in runs if not run.results]
    if len(found) == 1:
        found[0].label = ""
    return found


def _check(folder: Path) -> None:
    if not folder.is_dir():
        raise UserError(f"{folder} is not the folder of a run: there is no such folder.")
    if not any((*folder.glob(CONFIG), *folder.glob(PATTERN), *results_folders(folder))):
        below = sorted(path.parent for path in folder.glob(f"*/{CONFIG}"))
        hint = f" Name a folder below it, such as {below[-1]}." if below else ""
        raise UserError(
            f"{folder} is not the folder of a run: it holds no {CONFIG}, no TensorBoard events "
            f"and no tables.{hint}"
        )


def _read(folder: Path, name: str) -> Run:
    history = read_history(folder)
    run = Run(name, folder, history, unread=[*history.unread])
    path = folder / CONFIG
    if path.exists():
        with run.reading(path):
            run.check_inside(path)
            run.config = path.read_text(encoding="utf-8")
            config = read_yaml(run.config)
            if not isinstance(config, dict):
                raise ValueError("it holds no settings")
            run.settings = flat(config)
    for place, data in (results_folders(folder) or {folder: {}}).items():
        results = Results(run) if place == folder else Results(run, place.name)
        if isinstance(data.get("root"), str):
            results.data = data
        elif place != folder:
            note = place.relative_to(folder) / DATA_FILE
            run.unread.append(f"{note} cannot be read: it notes no data.")
        _read_results(results, place)
        if results.tables or results.pictures:
            run.results.append(results)
    run.results.sort(key=lambda results: not results.on_training_data)
    return run


def _read_results(results: Results, folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        # The name in old runs.
        name = path.stem.replace("foreign_context", PERMUTED)
        with results.run.reading(path):
            results.run.check_inside(path)
            if path.suffix == ".csv":
                results.tables[name] = read_table(path)
            elif path.suffix == ".md":
                lines = path.read_text(encoding="utf-8").splitlines()
                results.remarks[name] = [it for it in lines if it.strip() and it[0] != "|"]
            elif path.suffix == ".png":
                picture = path.read_bytes()
                if not picture.startswith(_PNG):
                    raise ValueError("it is not a PNG file")
                results.pictures[name] = picture
