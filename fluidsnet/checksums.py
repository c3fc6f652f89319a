"""SHA-256 checksums of data files and checkpoints, in the format of ``sha256sum``."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from fluidsnet.errors import UserError
from fluidsnet.whole_file import write_whole

#: File with the checksums of its folder; ``sha256sum --check`` reads it.
NAME = "SHA256SUMS"


def sha256_of(path: Path) -> str:
    """Return the SHA-256 hash of a file, in hexadecimal; computed once for a file as it is."""
    found = path.stat()
    return _sha256(path, found.st_size, found.st_mtime_ns, found.st_ino)


@cache
def _sha256(path: Path, *state: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def refresh(path: Path) -> None:
    """Write the checksum of a file again, where its folder has one.

    Raises:
        UserError: It cannot be written.
    """
    if path.name in _read(path.parent / NAME):
        write_checksums([path])


def write_checksums(paths: Iterable[Path]) -> list[Path]:
    """Write the checksums of files beside them, and keep those of other files there.

    Returns:
        Files that were written, one for each folder.

    Raises:
        UserError: One cannot be written.
    """
    written: dict[Path, None] = {}
    for path in paths:
        sums = path.parent / NAME
        entries = {**_read(sums), path.name: sha256_of(path)}
        write_whole(sums, "".join(f"{digest}  {name}\n" for name, digest in entries.items()))
        written[sums] = None
    return list(written)


def verify(path: Path) -> None:
    """Compare a file with its checksum, where its folder has one.

    Raises:
        UserError: They differ.
    """
    sums = path.parent / NAME
    expected = _read(sums).get(path.name)
    if expected is not None and expected != sha256_of(path):
        raise UserError(
            f"{path} is not the file that {sums} describes: it is damaged, or has changed since; "
            f"if that was on purpose, run `fluidsnet inspect --hash {path}`."
        )


def _read(sums: Path) -> dict[str, str]:
    if not sums.is_file():
        return {}
    lines = sums.read_text(errors="replace").splitlines()
    # A star before the name says that the file was read as binary.
    pairs = (line.split(maxsplit=1) for line in lines if line.strip())
    return {
        pair[1].removeprefix("*").removeprefix("./"): pair[0].lower()
        for pair in pairs
        if len(pair) == 2
    }
