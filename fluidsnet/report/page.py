"""The report as one HTML page that asks for nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from fluidsnet.report.document import Document, Part
from fluidsnet.report.grid import Grid, shown

_HERE = Path(__file__).parent


def page(document: Document) -> str:
    """Renders a document; pictures, curves and style are within the page."""
    # Whatever a run is called or configured with is text, never markup.
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters.update(shown=shown, kinds=_kinds, data=_data, groups=_groups)
    template = environment.from_string((_HERE / "page.html").read_text(encoding="utf-8"))
    style = (_HERE / "page.css").read_text(encoding="utf-8")
    return template.render(document=document, style=style)


def _kinds(grid: Grid) -> list[str]:
    """Of each column whether it holds numbers, which stand to the right, or text."""
    columns = zip(*grid.rows, strict=True)
    return [
        "number" if any(not isinstance(cell, str) for cell in column) else "text"
        for column in columns
    ]


def _groups(parts: Sequence[Part]) -> list[tuple[str, list[Part]]]:
    """Neighbors of a kind together: charts stand side by side where there is room."""
    return [(kind, list(same)) for kind, same in groupby(parts, key=lambda part: part.kind)]


def _data(path: Path) -> str:
    return f"data:image/png;base64,{b64encode(path.read_bytes()).decode()}"
