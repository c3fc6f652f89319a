"""Tables of the report: read from CSV, joined side by side, formatted."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain, count
from pathlib import Path
from typing import TypeVar

import pandas as pd

from fluidsnet.reporting.table import Cell

Key = TypeVar("Key", bound=Cell)

#: Shown for a missing value.
NONE = "–"


def frame(header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> pd.DataFrame:
    """Return a table whose cells keep their type; the first column names the rows."""
    return pd.DataFrame([*rows], columns=[*header], dtype=object)


def read_table(path: Path) -> pd.DataFrame:
    """Read a CSV file with a header; each cell is an int, a float or text.

    Raises:
        ValueError: The file is not a table.
        OSError: The file cannot be read.
    """
    try:
        # Only this engine tells a cell that is not there (NaN) from an empty one.
        table = pd.read_csv(path, dtype=str, keep_default_na=False, engine="python")
    except pd.errors.EmptyDataError:
        raise ValueError("it is empty") from None
    # pandas takes cells beyond the header for an index.
    ragged = table.isna().any(axis=None) or not isinstance(table.index, pd.RangeIndex)
    if table.empty or ragged:
        raise ValueError("it is not a header and rows of as many cells")
    return table.map(_cell).astype(object)


def shown(cell: Cell) -> str:
    """Format a cell: four digits, and an exponent only for very large or small numbers."""
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int):
        return f"{cell:,}"
    return f"{cell:,.0f}" if 1e4 <= abs(cell) < 1e9 else f"{cell:.4g}"


def side_by_side(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Join the tables of several runs by their first column.

    A column with equal values in all runs appears once; others get the run's name.

    Args:
        tables: Tables by the names of the runs; a single one is returned unchanged.
    """
    first = next(iter(tables.values()))
    if len(tables) == 1:
        return first
    indexed = {
        run: table.drop_duplicates(table.columns[0], keep="last").set_index(table.columns[0])
        for run, table in tables.items()
    }
    rows = union(table.index for table in indexed.values())
    joined = {}
    for name in union(table.columns for table in indexed.values()):
        columns = {
            run: table[name].reindex(rows, fill_value=NONE)
            for run, table in indexed.items()
            if name in table
        }
        values = next(iter(columns.values()))
        if len(columns) == len(tables) and all(same(values, it) for it in columns.values()):
            joined[name] = values
        else:
            joined |= {f"{name}, {run}": column for run, column in columns.items()}
    table = pd.DataFrame(joined, dtype=object)
    table.insert(0, first.columns[0], pd.Series(rows, index=table.index, dtype=object))
    return table.reset_index(drop=True)


def union(lists: Iterable[Iterable[Key]]) -> list[Key]:
    """Return the distinct items of all lists; new items of a list follow their predecessors."""
    found: list[Key] = []
    for items in lists:
        place = 0
        for item in items:
            if item in found:
                place = found.index(item) + 1
            else:
                found.insert(place, item)
                place += 1
    return found


def unique(name: str, taken: Collection[str]) -> str:
    """Return a name that is not taken, with a number behind it where needed."""
    numbered = (f"{name}_{number}" for number in count(2))
    return next(found for found in chain([name], numbered) if found not in taken)


def near(first: Cell, second: Cell) -> bool:
    """Return whether two cells agree up to rounding, as from another batch size."""
    if isinstance(first, str) or isinstance(second, str):
        return first == second
    return math.isclose(first, second, rel_tol=1e-4)


def same(first: Iterable[Cell], second: Iterable[Cell]) -> bool:
    """Return whether two lists of cells have the same length and agree up to rounding."""
    cells, others = [*first], [*second]
    return len(cells) == len(others) and all(map(near, cells, others))


def _cell(text: str) -> Cell:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
