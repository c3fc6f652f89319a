"""Parts of a report, and its files: HTML page, Markdown and CSV."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from jinja2 import Environment, StrictUndefined

from fluidsnet.report.tables import shown, unique
from fluidsnet.reporting.table import markdown, plain, write_csv
from fluidsnet.whole_file import write_whole

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
    def kinds(self) -> list[str]:
        """For each column "number", which is set to the right, or "text"."""
        texts = self.frame.map(lambda cell: isinstance(cell, str)).all()
        return ["text" if text else "number" for text in texts]


@dataclass(frozen=True)
class Figure:
    """A chart as an ``<svg>`` element, described in words for screen readers, or a PNG file."""

    caption: str
    words: str
    svg: str = ""
    png: bytes = b""


@dataclass(frozen=True)
class Folded:
    """A long text that opens at a click."""

    caption: str
    text: str


Part = Note | Table | Figure | Folded


def write_report(
    folder: Path, title: str, lead: str, sections: Mapping[str, Iterable[Part]]
) -> Path:
    """Write ``report.html``, ``report.md`` and a CSV file for each table; return the page's path.

    The folder is made. A section, which is parts by their heading, is left out if it has no parts.
    """
    contents = {heading: parts for heading, it in sections.items() if (parts := [*it])}
    # Autoescape: names and settings of a run are text, never markup.
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {
        "shown": shown,
        "slug": lambda heading: re.sub(r"\W+", "-", heading.lower()),
        "base64": lambda data: b64encode(data).decode(),
    }
    template = environment.from_string((_HERE / "page.html").read_text(encoding="utf-8"))
    style = (_HERE / "page.css").read_text(encoding="utf-8")
    page = template.render(title=title, lead=lead, sections=contents, style=style)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / "report.html", page)
    paragraphs = [f"# {plain(title)}", plain(lead)]
    names: list[str] = []
    for heading, parts in contents.items():
        if any(isinstance(part, Note | Table) for part in parts):
            paragraphs.append(f"## {plain(heading)}")
        for part in parts:
            if isinstance(part, Note):
                paragraphs.append(plain(part.text))
            elif isinstance(part, Table):
                names.append(unique(re.sub(r"[^\w.-]+", "_", part.name), names))
                rows = [
                    ["nan" if cell != cell else cell for cell in row]
                    for row in part.frame.itertuples(index=False, name=None)
                ]
                write_csv(folder / f"{names[-1]}.csv", [*part.frame.columns], rows)
                paragraphs += [f"{plain(part.caption)} ({names[-1]}.csv):", _markdown(part.frame)]
    write_whole(folder / "report.md", "\n\n".join(paragraphs) + "\n")
    return folder / "report.html"


def _markdown(table: pd.DataFrame) -> str:
    header, *rows = (
        [shown(cell) for cell in row]
        for row in ([*table.columns], *table.itertuples(index=False, name=None))
    )
    return markdown(header, rows).rstrip()
