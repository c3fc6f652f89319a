"""The files of a report: a page, the same tables as Markdown, and each as CSV."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from fluidsnet.report.document import Document, Note, Table
from fluidsnet.report.grid import Grid, shown
from fluidsnet.report.page import page
from fluidsnet.reporting.table import markdown


def write_report(document: Document, folder: Path) -> Path:
    """Writes ``report.html``, ``report.md`` and a CSV file a table.

    Args:
        document: that is written.
        folder: for the files; it is made.

    Returns:
        path of the page.
    """
    text = page(document)
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"# {document.title}", "", document.lead]
    written: set[str] = set()
    for section in document.sections:
        if any(isinstance(part, Note | Table) for part in section.parts):
            lines += ["", f"## {section.title}"]
        for part in section.parts:
            if isinstance(part, Note):
                lines += ["", part.text]
            elif isinstance(part, Table):
                name = _free(part.name, written)
                _write_csv(folder / f"{name}.csv", part.grid)
                lines += ["", f"{part.caption} ({name}.csv):", "", _markdown(part.grid)]
    (folder / "report.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    path = folder / "report.html"
    path.write_text(text, encoding="utf-8")
    return path


def _free(name: str, written: set[str]) -> str:
    """A file's name made of a table's; a run's may have signs that a file's must not."""
    plain = re.sub(r"[^\w.-]+", "_", name)
    number, found = 1, plain
    while found in written:
        number += 1
        found = f"{plain}_{number}"
    written.add(found)
    return found


def _write_csv(path: Path, grid: Grid) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(grid.header)
        writer.writerows(grid.rows)


def _markdown(grid: Grid) -> str:
    rows = [[_escaped(shown(cell)) for cell in row] for row in grid.rows]
    return markdown([_escaped(name) for name in grid.header], rows).rstrip()


def _escaped(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")
