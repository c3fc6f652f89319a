"""``fluidsnet report``: a page on one run, or on several side by side."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

from fluidsnet.errors import UserError
from fluidsnet.report.data import data_section
from fluidsnet.report.document import Document, Note, Section, write_report
from fluidsnet.report.events import PATTERN
from fluidsnet.report.results import glance_section, result_sections
from fluidsnet.report.run import CONFIG, Run, group_results, read_runs
from fluidsnet.report.settings import settings_section
from fluidsnet.report.training import ablation_section, training_section


def report_command(arguments: list[str]) -> None:
    """Write the report and print its path.

    Raises:
        UserError: A folder is not the folder of a run, or the report would lie in one or cannot
            be written.
    """
    parser = ArgumentParser(
        prog="fluidsnet report",
        description=(
            "Write a report on runs: one HTML page without further files, and its tables as "
            "Markdown and CSV. Several runs are set side by side."
        ),
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="such as runs/demo")
    parser.add_argument(
        "--output",
        type=Path,
        metavar="FOLDER",
        help="for the files; by default report in the run's folder; of several, beside the first",
    )
    options = parser.parse_args(arguments)
    runs = read_runs(options.runs)
    first: Path = options.runs[0]
    folder: Path = options.output or (first if len(runs) == 1 else _parent(first)) / "report"
    document = _document(runs)
    try:
        if (folder / CONFIG).exists() or any(folder.glob(PATTERN)):
            raise UserError(f"{folder} is the folder of a run; choose another --output.")
        if folder.exists() and not folder.is_dir():
            raise UserError(f"{folder} is a file; --output names a folder.")
        page = write_report(document, folder)
    except OSError as error:
        path = error.filename or folder
        raise UserError(
            f"{path} cannot be written: {error.strerror}; choose another --output."
        ) from error
    print(page)
    print(f"{folder}/report.md and *.csv hold the same tables.")


def _document(runs: Sequence[Run]) -> Document:
    groups = group_results(runs)
    sections = [
        glance_section(runs, groups),
        *result_sections(runs, groups),
        training_section(runs),
        ablation_section(runs, groups),
        settings_section(runs),
        data_section(runs),
    ]
    unread = [Note(f"{run.name}: {sentence}") for run in runs for sentence in run.unread]
    if unread:
        sections.append(Section("Files not read in full", [*unread]))
    folders = ", ".join(str(run.folder) for run in runs)
    lead = f"{len(runs)} runs side by side: {folders}." if len(runs) > 1 else f"From {folders}."
    return Document(f"FluidsNet: {', '.join(run.name for run in runs)}", lead, sections)


def _parent(folder: Path) -> Path:
    """Return the parent folder, also of the paths ``.`` and ``..``."""
    return (folder.resolve() if folder.name in ("", "..") else folder).parent
