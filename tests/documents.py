"""Documents of the repository: their code blocks, commands and links."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]

_BLOCK = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_INLINE = re.compile(r"(?<!`)`(fluidsnet [^`]+)`(?!`)")


@dataclass(frozen=True)
class Block:
    """Code block of a document; `line` is that of its first line of code."""

    path: Path
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}"


@dataclass(frozen=True)
class Command:
    """Command in a document."""

    path: Path
    line: int
    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}: {' '.join(self.words[:2])}"


def blocks(path: Path, *languages: str) -> list[Block]:
    """Return the code blocks of a document, of some languages."""
    text = path.read_text()
    return [
        Block(path, text.count("\n", 0, it.start(3)) + 1, it.group(2), dedent(it.group(3)))
        for it in _BLOCK.finditer(text)
        if it.group(2) in languages
    ]


def block_commands(block: Block) -> list[Command]:
    """Return the commands of a block: its lines, or of a ``text`` block those after ``$``."""
    found, begun, first = [], "", 0
    for number, line in enumerate(block.text.splitlines(), block.line):
        if block.language == "text":
            if not line.startswith("$ "):
                continue
            line = line.removeprefix("$ ")
        first = first if begun else number
        begun += line.removesuffix("\\") + "\n"
        try:
            words = shlex.split(begun, comments=True)
        except ValueError:  # a quotation goes on in the next line
            continue
        if line.endswith("\\"):
            continue
        if words:
            found.append(Command(block.path, first, tuple(words)))
        begun = ""
    assert not begun.strip(), f"{block}: a command does not end"
    return found


def commands(path: Path) -> list[Command]:
    """Return the commands of a document: in its blocks, and complete ones within its text."""
    found = [it for block in blocks(path, "sh", "text") for it in block_commands(block)]
    prose = _BLOCK.sub(lambda it: "\n" * it.group().count("\n"), path.read_text())
    for it in _INLINE.finditer(prose):
        if "--" in it.group(1) and not set("…<") & set(it.group(1)):
            line = prose.count("\n", 0, it.start()) + 1
            found.append(Command(path, line, tuple(shlex.split(it.group(1)))))
    return found


def save_files(path: Path, folder: Path) -> None:
    """Write the YAML blocks of a document that begin with a file's name, as the reader does."""
    for block in blocks(path, "yaml"):
        named = re.match(r"# ([\w.]+\.yaml)\n", block.text)
        if named:
            (folder / named.group(1)).write_text(block.text)


def links(path: Path) -> list[str]:
    """Return the targets of the links of a document to files."""
    text = re.sub(r"`[^`\n]*`", "", _BLOCK.sub("", path.read_text()))
    return [it for it in _LINK.findall(text) if "://" not in it]


def github_anchors(path: Path) -> set[str]:
    """Return the anchors that GitHub gives the headings of a document."""
    text = _BLOCK.sub("", path.read_text())
    headings = re.findall(r"^#+ +(.*?) *$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", it.lower()).replace(" ", "-") for it in headings}
