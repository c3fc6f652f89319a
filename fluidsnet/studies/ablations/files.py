"""The ablation study's numbers as CSV, with all their digits and a row a seed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fluidsnet.reporting.table import Cell, write_csv
from fluidsnet.studies.ablations.comparison import Comparison
from fluidsnet.studies.ablations.group import Group
from fluidsnet.studies.ablations.numbers import STARTS
from fluidsnet.studies.ablations.tables import ONE_STEP, ONE_STEP_ROWS, ROLLOUT, ROLLOUT_ROWS

_RUN = ("scene", "stride", "seed")


def write_files(
    folder: Path, groups: Sequence[Group], comparisons: Sequence[Comparison]
) -> list[str]:
    """Writes ``ablations.csv``, ``ablations_one_step.csv`` and ``ablations_rollouts.csv``.

    Args:
        folder: that they are written into.
        groups: the runs.
        comparisons: of these.

    Returns:
        the names of the files.
    """
    one_step: list[list[Cell]] = []
    rollouts: list[list[Cell]] = []
    for group in groups:
        for run in group.runs:
            start: list[Cell] = [group.scene, group.stride, run.trained.seed]
            for who in ONE_STEP_ROWS:
                values = [run.one_step(who, column) for column in ONE_STEP]
                _add(one_step, [*start, _words(who)], values)
            for table, words in STARTS.items():
                for moment in group.moments(table):
                    for who in ROLLOUT_ROWS:
                        values = [run.rollout(who, moment.steps, name, table) for name in ROLLOUT]
                        row = [*start, words, _words(who), moment.steps, moment.time]
                        _add(rollouts, row, values)
    tables = {
        "ablations.csv": (
            ("twin", "scene", "stride", "figure", "seeds", "twin / model", "from", "to",
             "each seed", "decided"),
            [_row(one) for one in comparisons],
        ),
        "ablations_one_step.csv": ((*_RUN, "predictor", *ONE_STEP), one_step),
        "ablations_rollouts.csv": (
            (*_RUN, "start", "predictor", "steps", "time s", *ROLLOUT.values()), rollouts,
        ),
    }  # fmt: skip
    for name, (header, rows) in tables.items():
        write_csv(folder / name, header, rows)
    return list(tables)


def _add(rows: list[list[Cell]], start: Sequence[Cell], values: Sequence[float | None]) -> None:
    if any(value is not None for value in values):
        rows.append([*start, *("" if value is None else value for value in values)])


def _row(one: Comparison) -> list[Cell]:
    return [
        _words(one.twin),
        one.group.scene,
        one.group.stride,
        one.figure,
        len(one.ratio.each),
        one.ratio.mean,
        *(one.ratio.interval or ("", "")),
        " ".join(map(repr, one.ratio.each)),
        one.decision,
    ]


def _words(who: str) -> str:
    """A name as the runs' own tables have it."""
    return who.replace("_", " ")
