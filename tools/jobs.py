"""Run installation commands in parallel and show their progress."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
LOG = VENV / "fluidsnet-install.log"

SECONDS_BETWEEN_LINES = 30.0
COMPILING = re.compile(r"^\s*(\[\d+/\d+\]|\S*(g\+\+|c\+\+|clang|cc)\S*\s.*\s-c\s)", re.MULTILINE)


class InstallError(Exception):
    """Error with one sentence for the user; `details` is printed before it."""

    def __init__(self, sentence: str, details: str = "") -> None:
        super().__init__(sentence)
        self.details = details


def say(sentence: str) -> None:
    """Print a line and flush."""
    print(sentence, flush=True)


@dataclass
class Job:
    """A command with a title for its progress and a log file for its output."""

    title: str
    command: list[str]
    log: Path = LOG
    environment: dict[str, str] = field(default_factory=dict)
    sources: str | None = None  # number of source files that it compiles
    when_done: Callable[[], None] = lambda: None
    process: subprocess.Popen[bytes] = field(init=False)
    began: float = field(init=False)

    def start(self) -> None:
        """Start the command in a new process group, so that `stop` ends its children too."""
        self.began = time.monotonic()
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                self.command,
                cwd=ROOT,
                env={**os.environ, **self.environment},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def stop(self) -> None:
        """End the command and its children if they still run."""
        if self.process.poll() is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGTERM)
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)

    def progress(self) -> str:
        """Return the title, the number of files compiled so far, and the elapsed time."""
        seconds = f"{time.monotonic() - self.began:.0f} s"
        if self.sources is None:
            return f"{self.title}: {seconds}"
        begun = len(COMPILING.findall(self.log.read_text(errors="replace")))
        return f"{self.title}: file {begun} of {self.sources}, {seconds}"

    def tail(self) -> str:
        """Return the log's last 15 lines before pip's report of a failure."""
        text = self.log.read_text(errors="replace").split("error: subprocess-exited-with-error")[0]
        return "\n".join(text.rstrip().splitlines()[-15:])


def run(*jobs: Job) -> None:
    """Run jobs in parallel; if one fails, end the others.

    Raises:
        InstallError: A job failed.
    """
    terminal = sys.stdout.isatty()
    clear = "\r\033[K" if terminal else ""
    running: list[Job] = []
    try:
        for job in jobs:
            job.start()
            running.append(job)
        next_line = time.monotonic() + (0 if terminal else SECONDS_BETWEEN_LINES)
        if not terminal:
            say("; ".join(job.title for job in jobs) + " …")
        while running:
            time.sleep(0.2)
            for job in [job for job in running if job.process.poll() is not None]:
                running.remove(job)
                print(clear, end="")
                if job.process.returncode != 0:
                    raise InstallError(f"{job.title} failed; its log is {job.log}.", job.tail())
                job.when_done()
                say(f"{job.progress()}, done")
            if running and time.monotonic() >= next_line:
                line = "; ".join(job.progress() for job in running)
                if terminal:
                    width = shutil.get_terminal_size().columns - 1
                    print(clear + line[:width], end="", flush=True)
                    next_line += 1
                else:
                    say(line)
                    next_line += SECONDS_BETWEEN_LINES
    finally:
        for job in running:
            job.stop()


def pip_install(title: str, *arguments: str) -> None:
    """Run ``pip install`` in `.venv`."""
    run(Job(title, [sys.executable, "-m", "pip", "install", "-q", *arguments]))
