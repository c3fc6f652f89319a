"""What runs came to: the test, the rollouts, the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.report.document import Note, Part, Picture, Section, Table
from fluidsnet.report.grid import NONE, Grid, near, side_by_side
from fluidsnet.report.run import ROLLED, TABLES, Run
from fluidsnet.report.training import best_of
from fluidsnet.reporting.table import Cell

_PICTURES = {
    "ablation.png": "The truth and every model against time; the lighter a particle, the faster",
    "rollout.png": "Truth and prediction side by side; the lighter a particle, the faster",
}
_TRIVIAL = tuple(name.replace("_", " ") for name in TRIVIAL_PREDICTORS)


def glance_section(runs: Sequence[Run]) -> Section:
    """A few numbers of each run."""
    rows: list[tuple[Cell, ...]] = []
    for name, values in zip(_GLANCE, zip(*map(_glance, runs), strict=True), strict=True):
        if any(value != NONE for value in values):
            rows.append((name, *values))
    section = Section("At a glance")
    if rows:
        grid = Grid(("figure", *(run.name for run in runs)), tuple(rows))
        section.parts.append(Table("glance", "The model in a few numbers", grid))
    else:
        section.parts.append(Note("No figures were logged.", missing=True))
    return section


def one_step_section(runs: Sequence[Run]) -> Section:
    """Errors one step ahead, beside the trivial predictors."""
    caption = "One step ahead from the true states of the test split"
    section = Section("One step ahead", _joined(runs, "one_step", caption))
    grids = [run.tables["one_step"] for run in runs if "one_step" in run.tables]
    if not _same_frames(grids):
        words = (
            "The trivial predictors differ from run to run: the runs were tested on other frames "
            "or at another time step, and their numbers must not be set beside each other."
        )
        section.parts.append(Note(words))
    return section


def rollout_section(runs: Sequence[Run]) -> Section:
    """Errors of rollouts, beside the trivial predictors."""
    section = Section("Rollouts")
    caption = "Mean particle error of the rollouts of predict"
    section.parts += _joined(runs, "rollout", caption)
    section.parts += _missing(runs, ROLLED)
    named = {table for run in runs for table in run.tables if table.startswith(f"{ROLLED}_")}
    for table in (ROLLED, *sorted(named)):
        section.parts += _measured(runs, table)
    return section


def picture_section(runs: Sequence[Run]) -> Section:
    """What the run drew."""
    section = Section("Pictures")
    for run in runs:
        for path in run.pictures:
            section.parts.append(Picture(f"{run.name}: {_shows(path)}", path))
        if not run.pictures:
            words = f"{run.name} has no pictures: fluidsnet predict --run {run.folder} draws one."
            section.parts.append(Note(words, missing=True))
    return section


def _shows(picture: Path) -> str:
    if picture.stem == ROLLED or picture.stem.startswith(f"{ROLLED}_"):
        return f"Errors and energies of the test's rollouts{_which(picture.stem)} against time"
    return _PICTURES.get(picture.name, picture.stem.replace("_", " "))


_GLANCE = (
    "training steps",
    "training, minutes",
    "best val/skill",
    "at step",
    "test: skill",
    "test: position_error_1 mm",
    "rollout: steps",
    "rollout: position error mm",
    "rollout: escaped %",
)


def _glance(run: Run) -> list[Cell]:
    curves = run.history.curves
    # The first step is 0; losses are logged every few, a validation after the last.
    steps: Cell = max((curve[-1][0] + 1 for curve in curves.values()), default=NONE)
    minutes: Cell = run.history.seconds / 60 if curves else NONE
    best = best_of("val/skill", curves.get("val/skill", ()))
    where, skill = best if best is not None else (NONE, NONE)
    last: Grid | None = run.tables.get("rollout")
    ends = [
        last.column(name)[-1] if last is not None and name in last.header else NONE
        for name in ("steps", "model mm", "escaped %")
    ]
    tested = [_of_model(run, name) for name in ("skill", "position_error_1 mm")]
    return [steps, minutes, skill, where, *tested, *ends]


def _of_model(run: Run, column: str) -> Cell:
    grid = run.tables.get("one_step")
    if grid is None or column not in grid.header:
        return NONE
    return dict(zip(grid.column(grid.header[0]), grid.column(column), strict=True)).get(
        "model", NONE
    )


def _joined(runs: Sequence[Run], name: str, caption: str) -> list[Part]:
    grids = {run.name: run.tables[name] for run in runs if name in run.tables}
    parts: list[Part] = [Table(name, caption, side_by_side(grids))] if grids else []
    return [*parts, *_missing(runs, name)]


def _measured(runs: Sequence[Run], table: str) -> list[Part]:
    """Every metric after the most steps that all have, and folded after each number of steps."""
    full = [(run, run.tables[table]) for run in runs if table in run.tables]
    parts: list[Part] = []
    steps = [{cell for cell in _steps(grid) if isinstance(cell, int)} for _, grid in full]
    common = set.intersection(*steps) if steps else set()
    if common:
        last = max(common)
        pivots = {run.name: _after(grid, last) for run, grid in full}
        # A table of one alone does not name it.
        whose = "" if len(full) == len(runs) else f" of {', '.join(pivots)}"
        caption = f"Every metric of the test's rollouts{_which(table)}{whose} after {last} steps"
        parts.append(Table(f"{table}_after_{last}", caption, side_by_side(pivots)))
    for run, grid in full:
        parts += [Note(words) for words in run.remarks[table]]
        name = table if len(runs) == 1 else f"{table}_{run.name}"
        caption = f"Every metric of {run.name}{_which(table)} after each number of steps"
        parts.append(Table(name, caption, grid, folded=True))
    return parts


def _which(name: str) -> str:
    """Which of the test's rollouts a table or picture is of, told by its name."""
    words = name.removeprefix(ROLLED).removeprefix("_").replace("_", " ")
    return f" ({words})" if words else ""


def _missing(runs: Sequence[Run], name: str) -> list[Part]:
    return [
        Note(
            f"{run.name} has no {name}.csv: fluidsnet {TABLES[name]} --run {run.folder} writes it.",
            missing=True,
        )
        for run in runs
        if name not in run.tables
    ]


def _same_frames(grids: Sequence[Grid]) -> bool:
    """Whether the trivial predictors, which know the frames alone, are as good in all."""
    found = [[cell for row in grid.rows if row[0] in _TRIVIAL for cell in row] for grid in grids]
    return all(
        len(found[0]) == len(other)
        and all(near(one, two) for one, two in zip(found[0], other, strict=True))
        for other in found[1:]
    )


def _steps(grid: Grid) -> list[Cell]:
    known = {"predictor", "steps"} <= set(grid.header)
    return grid.column("steps") if known else []


def _after(grid: Grid, steps: int) -> Grid:
    """A row a metric and a column a predictor."""
    rows = [
        dict(zip(grid.header, row, strict=True))
        for row, count in zip(grid.rows, grid.column("steps"), strict=True)
        if count == steps
    ]
    metrics = [name for name in grid.header if name not in ("predictor", "steps")]
    cells = ((metric, *(row[metric] for row in rows)) for metric in metrics)
    return Grid((f"after {steps} steps", *(str(row["predictor"]) for row in rows)), tuple(cells))
