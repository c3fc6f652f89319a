"""Sections on results: at a glance, one step ahead, rollouts, pictures."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.report.page import Figure, Note, Part, Table
from fluidsnet.report.run import PREDICTED, ROLLED, TABLES, Group, Results, Run
from fluidsnet.report.tables import NONE, same, side_by_side
from fluidsnet.report.training import best_of
from fluidsnet.reporting.table import Cell

_PICTURES = {
    "ablation": "The truth and every model against time; the lighter a particle, the faster",
    "rollout": "Truth and prediction side by side; the lighter a particle, the faster",
}
_TRIVIAL = [name.replace("_", " ") for name in TRIVIAL_PREDICTORS]
#: Figures at a glance: table and column.
_GLANCE = {
    "test: skill": ("one_step", "skill"),
    "test: position_error_1 mm": ("one_step", "position_error_1 mm"),
    "rollout: steps": (ROLLED, "steps"),
    "rollout: position error mm": (ROLLED, "position_error mm"),
    "rollout: escaped %": (ROLLED, "escaped %"),
}
#: Notes on the data that are shown only where they differ.
_DEFAULTS: dict[str, Any] = {"frame_range": [0, None], "sample_every": 1}


def glance(runs: Sequence[Run], groups: Sequence[Group]) -> Iterator[Part]:
    """Yield a summary table with the main metrics of each run."""
    figures = [_figures(run, groups) for run in runs]
    table = pd.DataFrame(figures, [run.name for run in runs], dtype=object).T
    table = table[(table != NONE).any(axis="columns")]
    table = table.reset_index(names="figure", allow_duplicates=True)
    if table.empty:
        yield Note("No figures were logged.", missing=True)
    else:
        yield Table("glance", "The model in a few numbers", table)


def result_sections(runs: Sequence[Run], groups: Sequence[Group]) -> dict[str, Iterator[Part]]:
    """Return three sections for each data set."""
    sections: dict[str, Iterator[Part]] = {}
    for group in groups:
        sections[group.named("One step ahead", ": ")] = _one_step(runs, group)
        sections[group.named("Rollouts", ": ")] = _rollouts(group)
        sections[group.named("Pictures", ": ")] = _pictures(group)
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
        results = group.of(run)
        tables = {**results.tables} if results else {}
        if PREDICTED in tables:
            tables.setdefault(ROLLED, tables[PREDICTED])
        for figure, (name, column) in _GLANCE.items():
            table = tables.get(name, pd.DataFrame([[""]]))
            cells = table[table.iloc[:, 0] == "model"].get(column, ())
            found[group.named(figure, ", ")] = [NONE, *cells][-1]
    return found


def _one_step(runs: Sequence[Run], group: Group) -> Iterator[Part]:
    for text in dict.fromkeys(_measured(runs, group)):
        yield Note(text)
    tables = group.tables("one_step")
    if tables:
        caption = "One step ahead from true states of the test split"
        yield Table(group.named("one_step"), caption, side_by_side(tables))
    rows = [table[table.iloc[:, 0].isin(_TRIVIAL)] for table in tables.values()]
    cells = [table.to_numpy().ravel().tolist() for table in rows]
    if not all(same(cells[0], others) for others in cells):
        yield Note(
            "The trivial predictors differ from run to run: the runs were tested on other frames "
            "or at another time step, and their numbers must not be set beside each other."
        )
    yield from _missing(group, "one_step")


def _measured(runs: Sequence[Run], group: Group) -> Iterator[str]:
    """Yield sentences on the data that the results of a group were measured on."""
    for run in runs:
        results = group.of(run)
        if results is None:
            others = " and ".join(_files(it) or it.label for it in run.results)
            yield f"{run.name} has no results on these data, but on {others}."
        elif results.data:
            yield from _data(results)
        elif results.tables or results.pictures:
            text = f"The data that {run.name} was measured on are not noted"
            yield f"{text}, as in runs of older versions."


def _files(results: Results) -> str:
    return ", ".join(map(str, results.files))


def _data(results: Results) -> Iterator[str]:
    data, run = results.data, results.run
    digests = str(data.get("sha256")).split(", ")
    parts = [
        f"{name.replace('_', ' ')} {value}"
        for name, value in data.items()
        if name not in ("root", "file", "sha256", "time_step") and value != _DEFAULTS.get(name)
    ]
    if isinstance(data.get("time_step"), int | float):
        parts.append(f"time step {1000 * data['time_step']:g} ms")
    short = ", ".join(digest[:12] for digest in digests)
    yield f"Measured on {_files(results)} (sha256 {short}): {', '.join(parts)}."
    for path, digest in zip(results.files, digests, strict=False):
        if path.is_file():
            with path.open("rb") as file:
                found = hashlib.file_digest(file, "sha256").hexdigest()
            if found != digest:
                text = f"{path} has changed since {run.name} was measured"
                yield f"{text}: its sha256 is now {found[:12]}."
    if "data.root" in run.settings and not results.on_training_data:
        yield f"{run.name} was trained on other data: {run.settings['data.root']}."


def _rollouts(group: Group) -> Iterator[Part]:
    tables = group.tables("rollout")
    if tables:
        caption = "Mean particle error of predict's rollouts"
        yield Table(group.named("rollout"), caption, side_by_side(tables))
    yield from _missing(group, ROLLED)
    yield from _missing(group, PREDICTED)
    found = {it for results in group.members for it in results.tables if it.startswith(ROLLED)}
    for name in sorted(found):
        yield from _rolled(group, name)


def _rolled(group: Group, name: str) -> Iterator[Part]:
    """Yield a table of every metric after the most common steps, and the full table, folded."""
    tables = group.tables(name)
    steps = [
        {step for step in table.get("steps", ()) if isinstance(step, int) and "predictor" in table}
        for table in tables.values()
    ]
    if common := set.intersection(*steps):
        last = max(common)
        # Name the runs where others have no such table.
        whose = "" if len(tables) == len(group.members) else f" of {', '.join(tables)}"
        caption = f"Every metric of {_rollouts_of(name)}{whose} after {last} steps"
        after = side_by_side({run: _after(table, last) for run, table in tables.items()})
        yield Table(group.named(f"{name}_after_{last}"), caption, after)
    for results in group.members:
        run = results.run.name
        if run in tables:
            yield from (Note(sentence) for sentence in results.remarks.get(name, ()))
            title = group.named(name + results.run.suffix)
            caption = f"Every metric of {run}{_which(name)} after each number of steps"
            yield Table(title, caption, tables[run], folded=True)


def _after(table: pd.DataFrame, steps: int) -> pd.DataFrame:
    """Return a row for each metric and a column for each predictor after a number of steps."""
    rows = table[table["steps"] == steps].drop_duplicates("predictor").drop(columns="steps")
    metrics = rows.set_index("predictor").T.rename_axis(index=f"after {steps} steps", columns=None)
    return metrics.reset_index().astype(object)


def _pictures(group: Group) -> Iterator[Part]:
    for results in group.members:
        for name, png in results.pictures.items():
            caption = _PICTURES.get(name, name.replace("_", " "))
            if name == ROLLED or name.startswith(f"{ROLLED}_"):
                caption = f"Errors and energies of {_rollouts_of(name)} against time"
            caption = f"{results.run.name}: {caption}"
            yield Figure(caption, caption, png=png)
        if not results.pictures:
            text = f"{results.run.name} has no pictures: {_command(results, 'predict')} draws one."
            yield Note(text, missing=True)


def _rollouts_of(name: str) -> str:
    return "predict's rollouts" if name == PREDICTED else f"the test's rollouts{_which(name)}"


def _which(name: str) -> str:
    """Return the description of the rollouts from a file's name, in parentheses."""
    which = name.removeprefix(ROLLED).removeprefix("_").replace("_", " ")
    return f" ({which})" if which else ""


def _missing(group: Group, name: str) -> Iterator[Part]:
    for results in group.members:
        if name not in results.tables:
            text = f"{results.run.name} has no {name}.csv: {_command(results, TABLES[name])}"
            yield Note(f"{text} writes it.", missing=True)


def _command(results: Results, name: str) -> str:
    """Return the command that measures a run on the data of results."""
    other = results.data and not results.on_training_data
    data = f" --data.init_args.root {results.data['root']}" if other else ""
    return f"fluidsnet {name} --run {results.run.folder}{data}"
