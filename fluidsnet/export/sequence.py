"""Folders of numbered files, one a frame."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Self

from fluidsnet.errors import UserError


class SequenceFolder:
    """Folder of numbered files that gets its name once it is complete.

    The files are ``<name>/<name>.0000.ply``, ``<name>.0001.ply`` and so on, and
    ``<name>/<name>.ply.series`` has their times, in the JSON format for series of ParaView. They
    are written to a hidden folder beside it, which is renamed when the ``with`` block ends, and
    removed if an exception ends it. An older sequence of that name is replaced; a folder with any
    other file is refused.

    Args:
        folder: Path of the folder.
        suffix: Suffix of the files, such as ``.ply``.

    Attributes:
        replaced: True if an older sequence is replaced.

    Raises:
        UserError: The path is a file, or a folder that is not a sequence alone.
    """

    def __init__(self, folder: Path, suffix: str) -> None:
        folder = folder.resolve()
        self.folder, self.suffix = folder, suffix
        self._times: dict[str, float] = {}
        self._temporary, self._older = (
            folder.with_name(f".{folder.name}.{os.getpid()}.{kind}") for kind in ("tmp", "old")
        )
        self.replaced = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
        if self.replaced and not _is_sequence(folder):
            raise UserError(
                f"{folder} exists and is not a sequence of this command alone; choose another "
                "--output, or move it."
            )

    def __enter__(self) -> Self:
        try:
            self._temporary.mkdir(parents=True)
        except OSError as error:
            raise UserError(f"{self.folder}: cannot be written: {error}.") from error
        return self

    def next_path(self, time: float) -> Path:
        """Return the path at which to write the file of the next frame.

        Args:
            time: Time of the frame, s.
        """
        name = f"{self.folder.name}.{len(self._times):04d}{self.suffix}"
        self._times[name] = time
        return self._temporary / name

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        if kind is not None:
            shutil.rmtree(self._temporary)
            return
        files = [{"name": name, "time": time} for name, time in self._times.items()]
        series = {"file-series-version": "1.0", "files": files}
        path = self._temporary / f"{self.folder.name}{self.suffix}.series"
        path.write_text(json.dumps(series, indent=1) + "\n")
        if self.folder.exists():
            os.replace(self.folder, self._older)
        os.replace(self._temporary, self.folder)
        shutil.rmtree(self._older, ignore_errors=True)


def _is_sequence(folder: Path) -> bool:
    """Return True if a folder has the file of a series and the files that it lists, no others."""
    if not folder.is_dir():
        return False
    found = {path.name for path in folder.iterdir()}
    series = [path for path in folder.iterdir() if path.suffix == ".series"]
    try:
        (path,) = series
        listed = {file["name"] for file in json.loads(path.read_text())["files"]}
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return found == {path.name, *listed}
