"""``fluidsnet report``: a page about one run, or about several side by side."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from fluidsnet.errors import UserError
from fluidsnet.report.compose import compose
from fluidsnet.report.events import PATTERN
from fluidsnet.report.files import write_report
from fluidsnet.report.run import CONFIG, read_runs


def report_command(arguments: list[str]) -> None:
    """Writes the report and says where it is.

    Raises:
        UserError: a folder is not one of a run, or the report would lie in one or cannot be
            written.
    """
    parser = ArgumentParser(
        prog="fluidsnet report",
        description=(
            "Writes what runs logged as one HTML page that needs nothing else, its tables also "
            "as Markdown and CSV. Several runs are set side by side."
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
    document = compose(runs)
    try:
        if (folder / CONFIG).exists() or any(folder.glob(PATTERN)):
            raise UserError(f"{folder} is the folder of a run; choose another --output.")
        if folder.exists() and not folder.is_dir():
            raise UserError(f"{folder} is a file; --output names a folder.")
        page = write_report(document, folder)
    except OSError as error:
        place = error.filename or folder
        raise UserError(
            f"{place} cannot be written: {error.strerror}; choose another --output."
        ) from error
    print(page)
    print(f"{folder}/report.md and *.csv hold the same tables.")


def _parent(folder: Path) -> Path:
    """The folder above; the paths ``.`` and ``..`` do not tell it by themselves."""
    return (folder.resolve() if folder.name in ("", "..") else folder).parent
