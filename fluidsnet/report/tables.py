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
    """Join tables by their first column; a single one is returned unchanged.

    A column with equal values in all tables appears once; others get the table's name.
    """
    first = next(iter(tables.values()))
    if len(tables) == 1:
        return first
    key = first.columns[0]
    indexed = {
        run: table.drop_duplicates(table.columns[0], keep="last").set_index(table.columns[0])
        for run, table in tables.items()
    }
    rows = union(table.index for table in indexed.values())
    joined: dict[str, list[Cell]] = {key: rows}
    for name in union(table.columns for table in indexed.values()):
        columns = {
            f"{name}, {run}": table[name].reindex(rows, fill_value=NONE).to_list()
            for run, table in indexed.items()
            if name in table
        }
        values = next(iter(columns.values()))
        shared = len(columns) == len(tables) and all(same(values, it) for it in columns.values())
        joined |= {name: values} if shared else columns
    return pd.DataFrame(joined, dtype=object)


def union(lists: Iterable[Iterable[Key]]) -> list[Key]:
    """Return the distinct items of all lists; new items of a list follow their predecessors."""
    found: list[Key] = []
    for items in lists:
        place = 0
        for item in items:
            if item not in found:
                found.insert(place, item)
            place = found.index(item) + 1
    return found


def unique(name: str, taken: Collection[str]) -> str:
    """Return a name that is not taken, with a number behind it where needed."""
    numbered = (f"{name}_{number}" for number in count(2))
    return next(it for it in chain([name], numbered) if it not in taken)


def near(first: Cell, second: Cell) -> bool:
    """Return whether two cells agree up to rounding, as from another batch size."""
    if isinstance(first, str) or isinstance(second, str):
        return first == second
    return math.isclose(first, second, rel_tol=1e-4)


def same(first: Sequence[Cell], second: Sequence[Cell]) -> bool:
    """Return whether two lists of cells have the same length and agree up to rounding."""
    return len(first) == len(second) and all(map(near, first, second))


def _cell(text: str) -> Cell:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
