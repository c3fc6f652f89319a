"""What a report is made of, before it is a page or a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from fluidsnet.report.grid import Grid


@dataclass(frozen=True)
class Note:
    """A sentence; one that is `missing` says what is not there and how to get it."""

    kind: ClassVar[str] = "note"
    text: str
    missing: bool = False


@dataclass(frozen=True)
class Table:
    """A table with the name of its CSV file; one that is `folded` opens at a click."""

    kind: ClassVar[str] = "table"
    name: str
    caption: str
    grid: Grid
    folded: bool = False


@dataclass(frozen=True)
class Chart:
    """Curves as SVG; `words` say what they show to who does not see them."""

    kind: ClassVar[str] = "chart"
    caption: str
    words: str
    svg: str


@dataclass(frozen=True)
class Picture:
    """A PNG file and what it shows."""

    kind: ClassVar[str] = "picture"
    caption: str
    path: Path


@dataclass(frozen=True)
class Folded:
    """A long text behind a line that opens it."""

    kind: ClassVar[str] = "folded"
    caption: str
    text: str


Part = Note | Table | Chart | Picture | Folded


@dataclass
class Section:
    """A heading and what is below it."""

    title: str
    parts: list[Part] = field(default_factory=list)

    @property
    def name(self) -> str:
        """For links within the page."""
        return self.title.lower().replace(" ", "-")


@dataclass
class Document:
    """A report.

    Attributes:
        title: of the page.
        lead: a sentence on what it is about.
        sections: in the order they are read.
    """

    title: str
    lead: str
    sections: list[Section]
