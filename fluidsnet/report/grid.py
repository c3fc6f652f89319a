"""Tables of a report: read from a run's files, set side by side, written for a reader."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from fluidsnet.reporting.table import Cell

Key = TypeVar("Key", bound=Cell)

#: Of a cell that has no value.
NONE = "–"


@dataclass(frozen=True)
class Grid:
    """A table.

    Attributes:
        header: a name a column, with its unit.
        rows: as many cells each; the first says what the row is of.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def column(self, name: str) -> list[Cell]:
        """The cells under a name."""
        place = self.header.index(name)
        return [row[place] for row in self.rows]


def read_grid(path: Path) -> Grid:
    """Reads a CSV file with a header.

    Raises:
        ValueError: it is no such table.
        OSError: it cannot be read.
    """
    with path.open(newline="", encoding="utf-8") as file:
        try:
            cells = [row for row in csv.reader(file) if row]
        except csv.Error as error:
            raise ValueError(str(error)) from error
    if not cells:
        raise ValueError("it is empty")
    header, *rows = cells
    if not rows or any(len(row) != len(header) for row in rows):
        raise ValueError("it is not a header and rows of as many cells")
    return Grid(tuple(header), tuple(tuple(map(_cell, row)) for row in rows))


def shown(cell: Cell) -> str:
    """A cell as a reader wants it: four digits, and no exponent where there need be none."""
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int):
        return f"{cell:,}"
    if not math.isfinite(cell):
        return f"{cell:g}"
    return f"{cell:,.0f}" if 1e4 <= abs(cell) < 1e9 else f"{cell:.4g}"


def side_by_side(grids: Mapping[str, Grid]) -> Grid:
    """One table of several: their rows joined by the first cell, a column for each of theirs.

    A column that says the same in all has its place once; another is named after its table.

    Args:
        grids: by the names of the runs; a single one stays as it is.
    """
    first = next(iter(grids.values()))
    if len(grids) == 1:
        return first
    keys = union([grid.column(grid.header[0]) for grid in grids.values()])
    header, columns = [first.header[0]], [list(keys)]
    for name in union([grid.header[1:] for grid in grids.values()]):
        found = {run: _values(grid, name, keys) for run, grid in grids.items()}
        values = list(found.values())
        if all(_same(values[0], other) for other in values[1:]):
            header.append(name)
            columns.append(values[0])
            continue
        for run, column in found.items():
            if name in grids[run].header:
                header.append(f"{name}, {run}")
                columns.append(column)
    return Grid(tuple(header), tuple(zip(*columns, strict=True)))


def union(lists: Iterable[Iterable[Key]]) -> list[Key]:
    """What is in any list, each once, a later list's news after what they follow there."""
    found: list[Key] = []
    for cells in lists:
        place = 0
        for cell in cells:
            if cell in found:
                place = found.index(cell) + 1
            else:
                found.insert(place, cell)
                place += 1
    return found


def near(one: Cell, other: Cell) -> bool:
    """Whether two cells say the same, but for the rounding of another batch size."""
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return one == other or math.isclose(one, other, rel_tol=1e-4)


def _cell(text: str) -> Cell:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _values(grid: Grid, name: str, keys: Sequence[Cell]) -> list[Cell]:
    if name not in grid.header:
        return [NONE] * len(keys)
    known = dict(zip(grid.column(grid.header[0]), grid.column(name), strict=True))
    return [known.get(key, NONE) for key in keys]


def _same(one: Sequence[Cell], other: Sequence[Cell]) -> bool:
    return all(near(a, b) for a, b in zip(one, other, strict=True))
