"""Files of a run: configuration, training curves, and results on each data set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from fluidsnet.errors import UserError
from fluidsnet.report.events import PATTERN, History, read_history
from fluidsnet.report.tables import read_table, unique
from fluidsnet.reporting.results import DATA_FILE, RESULTS, results_folders

CONFIG = "config.yaml"
#: Table of rollouts; those of `predict` and of a `RolloutMetrics` with a name append to it.
ROLLED = "rollout_metrics"
PREDICTED = f"{ROLLED}_predict"
PERMUTED = "global_feature_permutation"
#: Tables of results and the commands that write them.
TABLES = {"one_step": "test", ROLLED: "test", PREDICTED: "predict", PERMUTED: "test"}
#: Tables of old runs: file name and today's name.
_OLD_TABLES = {"rollout": "rollout", "foreign_context": PERMUTED}
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass
class Results:
    """Tables and pictures of a run on one data set.

    Attributes:
        label: Name of the results folder.
        data: Contents of its `data.json`; empty where the data are not noted, as in old runs.
        tables: Tables by name.
        remarks: Sentences below a table in its Markdown file, by the table's name.
        pictures: PNG files.
    """

    label: str = "data not noted"
    data: dict[str, Any] = field(default_factory=dict)
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    remarks: dict[str, list[str]] = field(default_factory=dict)
    pictures: list[Path] = field(default_factory=list)

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
    def path(self) -> str:
        """Data files for a reader."""
        return ", ".join(map(str, self.files)) or self.label


@dataclass
class Run:
    """Contents of a run's folder.

    Attributes:
        name: Short name, unique in the report.
        folder: Folder of the run.
        config: Configuration; None where there is none that can be read.
        config_text: Text of the configuration's file.
        history: Training curves.
        results: Results on each data set, those on the data of the training first.
        unread: A sentence for each file that is damaged or cannot be read.
    """

    name: str
    folder: Path
    config: dict[str, Any] | None = None
    config_text: str = ""
    history: History = field(default_factory=History)
    results: list[Results] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)

    @property
    def data(self) -> dict[str, Any]:
        """Settings of the data module."""
        data = (self.config or {}).get("data")
        settings = data.get("init_args", data) if isinstance(data, dict) else None
        return settings if isinstance(settings, dict) else {}

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """Tables of the first results."""
        return self.results[0].tables if self.results else {}

    def trained_on(self, results: Results) -> bool:
        """Return whether results are on the data folder that the run was trained on."""
        roots = {str(Path(str(it.get("root"))).resolve()) for it in (self.data, results.data)}
        return len(roots) == 1


@dataclass
class Group:
    """Results of runs on the same data.

    Attributes:
        label: Short name of the data; empty if the report has no other data.
        results: By the name of the run; empty ones for runs without any results.
    """

    label: str
    results: dict[str, Results]

    def named(self, title: str, separator: str = "_") -> str:
        """Return a title with the label behind it."""
        return f"{title}{separator}{self.label}" if self.label else title


def read_runs(folders: Sequence[Path]) -> list[Run]:
    """Read the folders of runs.

    Raises:
        UserError: A folder is not the folder of a run, or is named twice.
    """
    for folder in folders:
        _check(folder)
    places = [folder.resolve() for folder in folders]
    for index, place in enumerate(places):
        if place in places[:index]:
            raise UserError(f"{folders[index]} is named twice.")
    return [_read(folder, name) for folder, name in zip(folders, names(places), strict=True)]


def names(places: Sequence[Path]) -> list[str]:
    """Return the shortest path endings that are distinct; `version_0` alone is not enough.

    Args:
        places: Distinct absolute paths.
    """
    shortest = 2 if any(place.name.startswith("version_") for place in places) else 1
    for length in range(shortest, max(len(place.parts) for place in places) + 1):
        ends = ["/".join(place.parts[-length:]) for place in places]
        if len(set(ends)) == len(ends):
            break
    return ends


def group_results(runs: Sequence[Run]) -> list[Group]:
    """Group the results of runs by their data; there is at least one group."""
    found: dict[tuple[str, int], dict[str, Results]] = {}
    for run in runs:
        # A run may have results on several copies of a data file.
        copies = Counter[str]()
        for results in run.results:
            found.setdefault((results.key, copies[results.key]), {})[run.name] = results
            copies[results.key] += 1
    members = [*found.values()] or [{}]
    for run in runs:
        if not run.results:
            members[0][run.name] = Results()
    if len(members) == 1:
        return [Group("", members[0])]
    groups: list[Group] = []
    for it in members:
        label = unique(next(iter(it.values())).label, [group.label for group in groups])
        groups.append(Group(label, it))
    return groups


def _check(folder: Path) -> None:
    if not folder.is_dir():
        raise UserError(f"{folder} is not the folder of a run: there is no such folder.")
    tables = (f"{table}.csv" for table in (*TABLES, *_OLD_TABLES))
    known = (CONFIG, PATTERN, *tables, f"{RESULTS}/*/{DATA_FILE}")
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
    for place, data in (results_folders(folder) or {folder: {}}).items():
        results = _read_results(run, place)
        if place != folder:
            results.label = place.name
            if "root" in data:
                results.data = data
            else:
                run.unread.append(
                    f"{place.relative_to(folder) / DATA_FILE} cannot be read: it notes no data."
                )
        if results.tables or results.pictures:
            run.results.append(results)
    run.results.sort(key=lambda results: not run.trained_on(results))
    return run


def _read_results(run: Run, folder: Path) -> Results:
    results = Results()
    tables = {name: name for name in TABLES} | _OLD_TABLES
    tables |= {path.stem: path.stem for path in sorted(folder.glob(f"{ROLLED}_*.csv"))}
    for file, table in tables.items():
        path = folder / f"{file}.csv"
        if path.exists():
            try:
                results.tables[table] = read_table(path)
            except (OSError, ValueError) as error:
                run.unread.append(f"{path.relative_to(run.folder)} cannot be read: {error}.")
            results.remarks[table] = _remarks(path.with_suffix(".md"))
    for path in sorted(folder.glob("*.png")):
        if path.read_bytes()[:8] == _PNG:
            results.pictures.append(path)
        else:
            name = path.relative_to(run.folder)
            run.unread.append(f"{name} cannot be read: it is not a PNG file.")
    return results


def _read_config(run: Run) -> None:
    path = run.folder / CONFIG
    if not path.exists():
        return
    try:
        run.config_text = path.read_text(encoding="utf-8")
        config = yaml.safe_load(run.config_text)
    except (OSError, UnicodeError, yaml.YAMLError):
        run.unread.append(f"{CONFIG} cannot be read: it is not plain YAML.")
        return
    run.config = config if isinstance(config, dict) else None
    run.unread += [] if isinstance(config, dict) else [f"{CONFIG} holds no settings."]


def _remarks(path: Path) -> list[str]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeError):
        return []
    return [line for line in lines if line.strip() and not line.startswith("|")]
