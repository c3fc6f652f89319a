"""Tables as Markdown and CSV files."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

from fluidsnet.printable import printable
from fluidsnet.whole_file import whole_file, write_whole

Cell = str | float | int


def write_table(path: Path, header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """Write ``<path>.csv`` and ``<path>.md``.

    Args:
        path: Path without a suffix; its folder is made.
        header: Column names with units.
        rows: A cell for each column.

    Returns:
        The Markdown table.
    """
    write_csv(path.with_suffix(".csv"), header, rows)
    text = markdown(header, rows)
    write_whole(path.with_suffix(".md"), text)
    return text


def write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
    """Write a CSV file, numbers with all digits.

    Args:
        path: Path of the file; its folder is made.
        header: Column names with units.
        rows: A cell for each column.
    """
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerows([harmless(cell) for cell in row] for row in (header, *rows))


def harmless(cell: Cell) -> Cell:
    """Return a cell that no spreadsheet takes for a formula."""
    if isinstance(cell, str) and cell.startswith(("=", "+", "-", "@", "\t", "\r")):
        return f"'{cell}"
    return cell


def plain(text: str) -> str:
    """Return a text without HTML tags and control characters, for Markdown and a terminal."""
    return printable(re.sub(r"<(?=[A-Za-z/!?])", "&lt;", text))


def markdown(header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """Return a Markdown table with aligned columns.

    Args:
        header: Column names with units.
        rows: A cell for each column; numbers are rounded to four digits.
    """
    names, *cells = [[_text(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(names, *cells, strict=True)]
    lines = [
        _line([name.ljust(width) for name, width in zip(names, widths, strict=True)]),
        _line(["-" * (width - 1) + ":" for width in widths]),
        *(
            _line([cell.rjust(width) for cell, width in zip(row, widths, strict=True)])
            for row in cells
        ),
    ]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _text(cell: Cell) -> str:
    if not isinstance(cell, str):
        return f"{cell:.4g}"
    # A bar would end the cell.
    return re.sub(r"(?<!\\)\|", r"\|", plain(cell).replace("\n", " "))
