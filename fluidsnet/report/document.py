"""Parts of a report, and its files: HTML page, Markdown and CSV."""

from __future__ import annotations

import re
from base64 import b64encode
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from pathlib import Path

import pandas as pd
from jinja2 import Environment, StrictUndefined

from fluidsnet.report.tables import shown, unique
from fluidsnet.reporting.table import Cell, markdown, write_csv

_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Note:
    """A sentence; a `missing` one says what is absent and which command makes it."""

    text: str
    missing: bool = False


@dataclass(frozen=True)
class Table:
    """A table with the name of its CSV file; a `folded` one opens at a click."""

    name: str
    caption: str
    frame: pd.DataFrame
    folded: bool = False

    @property
    def rows(self) -> list[list[Cell]]:
        """Cells of each row."""
        rows: list[list[Cell]] = self.frame.to_numpy(dtype=object).tolist()
        return rows

    @property
    def kinds(self) -> list[str]:
        """For each column "number", which is set to the right, or "text"."""
        columns = zip(*self.rows, strict=True)
        return ["text" if all(isinstance(cell, str) for cell in it) else "number" for it in columns]


@dataclass(frozen=True)
class Chart:
    """Curves as SVG, described in `words` for screen readers."""

    caption: str
    words: str
    svg: str


@dataclass(frozen=True)
class Picture:
    """A PNG file with a caption."""

    caption: str
    path: Path

    @property
    def data(self) -> str:
        """The file as a URL."""
        return f"data:image/png;base64,{b64encode(self.path.read_bytes()).decode()}"


@dataclass(frozen=True)
class Folded:
    """A long text that opens at a click."""

    caption: str
    text: str


Part = Note | Table | Chart | Picture | Folded


@dataclass
class Section:
    """A heading and the parts below it."""

    title: str
    parts: list[Part] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Name for links within the page."""
        return re.sub(r"\W+", "-", self.title.lower())


@dataclass
class Document:
    """A report: title, a first sentence, and sections."""

    title: str
    lead: str
    sections: list[Section]


def write_report(document: Document, folder: Path) -> Path:
    """Write ``report.html``, ``report.md`` and a CSV file for each table.

    Args:
        document: Report to write.
        folder: Folder of the files; it is made.

    Returns:
        Path of the page.
    """
    page = _page(document)
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"# {document.title}", "", document.lead]
    names: list[str] = []
    for section in document.sections:
        if any(isinstance(part, Note | Table) for part in section.parts):
            lines += ["", f"## {section.title}"]
        for part in section.parts:
            if isinstance(part, Note):
                lines += ["", part.text]
            elif isinstance(part, Table):
                name = unique(re.sub(r"[^\w.-]+", "_", part.name), names)
                names.append(name)
                write_csv(folder / f"{name}.csv", [*part.frame.columns], part.rows)
                lines += ["", f"{part.caption} ({name}.csv):", "", _markdown(part)]
    (folder / "report.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    path = folder / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


def _page(document: Document) -> str:
    """Render the page with its style, curves and pictures inside."""
    # Autoescape: names and settings of a run are text, never markup.
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    # Consecutive parts of a class are grouped, as charts stand side by side.
    by_kind = partial(groupby, key=lambda part: type(part).__name__)
    environment.filters.update(shown=shown, by_kind=by_kind)
    template = environment.from_string((_HERE / "page.html").read_text(encoding="utf-8"))
    style = (_HERE / "page.css").read_text(encoding="utf-8")
    return template.render(document=document, style=style)


def _markdown(table: Table) -> str:
    header, *rows = (
        [shown(cell).replace("|", r"\|").replace("\n", " ") for cell in row]
        for row in ([*table.frame.columns], *table.rows)
    )
    return markdown(header, rows).rstrip()
