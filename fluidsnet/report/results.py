"""Sections on results: at a glance, one step ahead, rollouts, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.report.data import measured_notes
from fluidsnet.report.document import Note, Part, Picture, Section, Table
from fluidsnet.report.run import PREDICTED, ROLLED, TABLES, Group, Results, Run
from fluidsnet.report.tables import NONE, frame, same, side_by_side
from fluidsnet.report.training import best_of
from fluidsnet.reporting.table import Cell

_PICTURES = {
    "ablation.png": "The truth and every model against time; the lighter a particle, the faster",
    "rollout.png": "Truth and prediction side by side; the lighter a particle, the faster",
}
_TRIVIAL = tuple(name.replace("_", " ") for name in TRIVIAL_PREDICTORS)
#: Runs and their results on the data of a group.
_Members = Sequence[tuple[Run, Results]]


def glance_section(runs: Sequence[Run], groups: Sequence[Group]) -> Section:
    """Build the table of a few figures of each run."""
    columns = [_figures(run, groups) for run in runs]
    rows = [
        (figure, *(column[figure] for column in columns))
        for figure in columns[0]
        if any(column[figure] != NONE for column in columns)
    ]
    if not rows:
        return Section("At a glance", [Note("No figures were logged.", missing=True)])
    table = frame(("figure", *(run.name for run in runs)), rows)
    return Section("At a glance", [Table("glance", "The model in a few numbers", table)])


def result_sections(runs: Sequence[Run], groups: Sequence[Group]) -> list[Section]:
    """Build three sections for each data set."""
    sections = []
    for group in groups:
        members = [(run, group.results[run.name]) for run in runs if run.name in group.results]
        parts: dict[str, list[Part]] = {
            "One step ahead": [*measured_notes(runs, group), *_one_step(members, group)],
            "Rollouts": _rollouts(members, group),
            "Pictures": _pictures(members),
        }
        sections += [Section(group.named(title, ": "), found) for title, found in parts.items()]
    return sections


def _figures(run: Run, groups: Sequence[Group]) -> dict[str, Cell]:
    curves = run.history.curves
    step, skill = best_of("val/skill", curves.get("val/skill", ())) or (NONE, NONE)
    found: dict[str, Cell] = {
        # The first step is 0; losses are logged every few steps, a validation after the last.
        "training steps": max((curve[-1][0] + 1 for curve in curves.values()), default=NONE),
        "training, minutes": run.history.seconds / 60 if curves else NONE,
        "best val/skill": skill,
        "at step": step,
    }
    for group in groups:
        tables = group.results.get(run.name, Results()).tables
        test, rollouts = tables.get("one_step"), tables.get(ROLLED, tables.get(PREDICTED))
        figures = {
            "test: skill": _last(test, "skill"),
            "test: position_error_1 mm": _last(test, "position_error_1 mm"),
            "rollout: steps": _last(rollouts, "steps"),
            "rollout: position error mm": _last(rollouts, "position_error mm"),
            "rollout: escaped %": _last(rollouts, "escaped %"),
        }
        found |= {group.named(name, ", "): value for name, value in figures.items()}
    return found


def _last(table: pd.DataFrame | None, column: str) -> Cell:
    """Return the model's last cell in a column."""
    if table is None or column not in table:
        return NONE
    cells: list[Cell] = table.loc[table.iloc[:, 0] == "model", column].to_list()
    return cells[-1] if cells else NONE


def _one_step(members: _Members, group: Group) -> list[Part]:
    parts = _joined(members, group, "one_step", "One step ahead from true states of the test split")
    trivial = [
        table[table.iloc[:, 0].isin(_TRIVIAL)].to_numpy().ravel().tolist()
        for _, results in members
        for table in [results.tables.get("one_step")]
        if table is not None
    ]
    if not all(same(trivial[0], cells) for cells in trivial):
        text = (
            "The trivial predictors differ from run to run: the runs were tested on other frames "
            "or at another time step, and their numbers must not be set beside each other."
        )
        parts.append(Note(text))
    return parts + _missing(members, "one_step")


def _rollouts(members: _Members, group: Group) -> list[Part]:
    parts = _joined(members, group, "rollout", "Mean particle error of predict's rollouts")
    parts += _missing(members, ROLLED) + _missing(members, PREDICTED)
    further = {it for _, results in members for it in results.tables if it.startswith(ROLLED)}
    for table in (ROLLED, *sorted(further - {ROLLED})):
        parts += _rolled(members, group, table)
    return parts


def _rolled(members: _Members, group: Group, name: str) -> list[Part]:
    """Build a table of every metric after the most common steps, and the full table, folded."""
    full = [(run, it, it.tables[name]) for run, it in members if name in it.tables]
    parts: list[Part] = []
    steps = [
        {step for step in table["steps"] if isinstance(step, int)}
        if {"predictor", "steps"} <= {*table.columns}
        else set[int]()
        for _, _, table in full
    ]
    common = set.intersection(*steps) if steps else set()
    if common:
        last = max(common)
        tables = {run.name: _after(table, last) for run, _, table in full}
        # Name the runs where others have no such table.
        whose = "" if len(full) == len(members) else f" of {', '.join(tables)}"
        caption = f"Every metric of {_rollouts_of(name)}{whose} after {last} steps"
        title = group.named(f"{name}_after_{last}")
        parts.append(Table(title, caption, side_by_side(tables)))
    for run, results, table in full:
        parts += [Note(sentence) for sentence in results.remarks[name]]
        title = group.named(name if len(members) == 1 else f"{name}_{run.name}")
        caption = f"Every metric of {run.name}{_which(name)} after each number of steps"
        parts.append(Table(title, caption, table, folded=True))
    return parts


def _after(table: pd.DataFrame, steps: int) -> pd.DataFrame:
    """Return a row for each metric and a column for each predictor after a number of steps."""
    rows = table[table["steps"] == steps].drop_duplicates("predictor").drop(columns="steps")
    metrics = rows.set_index("predictor").T.rename_axis(index=f"after {steps} steps", columns=None)
    return metrics.reset_index().astype(object)


def _pictures(members: _Members) -> list[Part]:
    parts: list[Part] = []
    for run, results in members:
        parts += [Picture(f"{run.name}: {_shows(path)}", path) for path in results.pictures]
        if not results.pictures:
            text = f"{run.name} has no pictures: {_command(run, results, 'predict')} draws one."
            parts.append(Note(text, missing=True))
    return parts


def _shows(picture: Path) -> str:
    if picture.stem == ROLLED or picture.stem.startswith(f"{ROLLED}_"):
        return f"Errors and energies of {_rollouts_of(picture.stem)} against time"
    return _PICTURES.get(picture.name, picture.stem.replace("_", " "))


def _rollouts_of(name: str) -> str:
    return "predict's rollouts" if name == PREDICTED else f"the test's rollouts{_which(name)}"


def _which(name: str) -> str:
    """Return the rollouts that a table's or picture's name tells, in parentheses."""
    which = name.removeprefix(ROLLED).removeprefix("_").replace("_", " ")
    return f" ({which})" if which else ""


def _joined(members: _Members, group: Group, name: str, caption: str) -> list[Part]:
    tables = {run.name: it.tables[name] for run, it in members if name in it.tables}
    return [Table(group.named(name), caption, side_by_side(tables))] if tables else []


def _missing(members: _Members, name: str) -> list[Part]:
    return [
        Note(f"{run.name} has no {name}.csv: {_command(run, it, TABLES[name])} writes it.", True)
        for run, it in members
        if name not in it.tables
    ]


def _command(run: Run, results: Results, name: str) -> str:
    """Return the command that measures a run on the data of results."""
    other = results.data and not run.trained_on(results)
    data = f" --data.init_args.root {results.data['root']}" if other else ""
    return f"fluidsnet {name} --run {run.folder}{data}"
