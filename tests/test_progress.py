"""Progress bars in a terminal and in a file."""

from __future__ import annotations

import io
import os
import pty
from pathlib import Path

import pytest

from fluidsnet import progress
from fluidsnet.progress import Progress


def test_a_file_gets_a_line_each_interval_and_one_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    path = tmp_path / "log"
    with path.open("w") as file:
        with Progress(total=25, desc="writing", unit="frame", file=file) as bar:
            for step in range(25):
                now = float(step)
                bar.update()
                bar.set_postfix(loss=step)
        for _ in Progress(range(3), file=file, leave=False):
            pass
        for _ in Progress(range(3), file=file, disable=True):
            pass
        Progress.write("a message", file=file)
    lines = path.read_bytes().decode().splitlines()
    assert [line.partition(",")[0] for line in lines] == [
        "writing: 11/25",
        "writing: 21/25",
        "writing: 25/25",
        "a message",
    ]
    assert "frame/s" in lines[0] and lines[2].endswith("loss=24")
    assert "\r" not in path.read_text()


def test_a_nested_bar_leaves_no_empty_line_in_a_file() -> None:
    file = io.StringIO()
    with Progress(total=2, desc="outer", file=file) as outer:
        for _ in range(2):
            for _ in Progress(range(2), desc="inner", file=file, leave=False):
                pass
            outer.update()
    assert [line.partition(",")[0] for line in file.getvalue().splitlines()] == ["outer: 2/2"]


def test_a_terminal_gets_a_bar() -> None:
    reader, writer = pty.openpty()
    with os.fdopen(writer, "w") as terminal:
        for _ in Progress(range(3), desc="writing", file=terminal, ncols=60):
            pass
        shown = ""
        while "3/3" not in shown:
            shown += os.read(reader, 10_000).decode()
    os.close(reader)
    assert "\r" in shown and "writing: 100%" in shown and "3/3" in shown
