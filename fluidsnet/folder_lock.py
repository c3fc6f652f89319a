"""Lock on a folder that one process at a time may write to."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fluidsnet.errors import UserError


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a folder, which is made, for this process; the lock ends with the process.

    It is on the folder itself and leaves no file. A file system that has no locks is used without.

    Args:
        folder: Folder that a command writes to.

    Raises:
        UserError: Another process holds it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise UserError(
            f"{folder} cannot be written: {error.strerror}; choose another folder."
        ) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UserError(
                f"{folder} is in use by another process of fluidsnet; wait until it ends, or "
                "choose another folder."
            ) from error
        except OSError:
            pass
        yield
    finally:
        os.close(descriptor)
