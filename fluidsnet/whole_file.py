"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fluidsnet.errors import UserError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, and rename it when the block ends.

    A full disk or a kill leaves an earlier file as it was.

    Args:
        path: File; its folder is made.

    Raises:
        UserError: It cannot be written.
    """
    # The suffix tells a format to what writes it.
    partial = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        partial.replace(path)
    except OSError as error:
        if error.errno is None:
            raise
        kept = "; the earlier one is whole" if path.is_file() else ""
        raise UserError(
            f"{path} cannot be written: {os.strerror(error.errno)}{kept}; choose another folder."
        ) from error
    finally:
        if partial.exists():
            partial.unlink()


def write_whole(path: Path, text: str) -> None:
    """Write a text as UTF-8.

    Raises:
        UserError: It cannot be written; an earlier file is whole.
    """
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
