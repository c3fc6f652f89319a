"""``fluidsnet report``: a page on one run, or on several side by side."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from fluidsnet.errors import UserError
from fluidsnet.folder_lock import FolderLock
from fluidsnet.report.events import PATTERN
from fluidsnet.report.page import Note, write_report
from fluidsnet.report.results import glance, result_sections
from fluidsnet.report.run import CONFIG, group_results, read_runs
from fluidsnet.report.settings import data, settings
from fluidsnet.report.training import ablations, training


def report_command(arguments: list[str]) -> None:
    """Write the report and print its path.

    Raises:
        UserError: A folder is not the folder of a run, or the report would lie in one or cannot
            be written.
    """
    parser = ArgumentParser(
        prog="fluidsnet report",
        description="Write a report on runs: one HTML page without further files, and its tables "
        "as Markdown and CSV. Several runs are set side by side.",
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
    groups = group_results(runs)
    sections = {
        "At a glance": glance(runs, groups),
        **result_sections(runs, groups),
        "Training": training(runs),
        "Ablations": ablations(runs, groups),
        "Configuration": settings(runs),
        "Data": data(runs),
        "Files not read in full": (
            Note(f"{run.name}: {sentence}") for run in runs for sentence in run.unread
        ),
    }
    folders = ", ".join(str(run.folder) for run in runs)
    lead = f"{len(runs)} runs side by side: {folders}." if len(runs) > 1 else f"From {folders}."
    title = f"FluidsNet: {', '.join(run.name for run in runs)}"
    first: Path = options.runs[0]
    if len(runs) > 1:
        # The paths . and .. name no parent.
        first = (first.resolve() if first.name in ("", "..") else first).parent
    folder: Path = options.output or first / "report"
    if (folder / CONFIG).exists() or any(folder.glob(PATTERN)):
        raise UserError(f"{folder} is the folder of a run; choose another --output.")
    with FolderLock(folder):
        page = write_report(folder, title, lead, sections)
    print(page)
    print(f"{folder}/report.md and *.csv hold the same tables.")
