"""Lock on a folder that one process at a time may write to."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import Any, Self, final
from weakref import WeakSet

from fluidsnet.errors import UserError


@final
class FolderLock:
    """Context manager that holds a folder, which is made; the lock ends with the process.

    It is on the folder itself and leaves no file. A file system that has no locks is used without.
    A copy of it holds nothing, in a forked process either.

    Args:
        folder: Folder that a command writes to.

    Raises:
        UserError: On entry: another process holds it, or it cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._descriptor: int | None = None
        _LOCKS.add(self)

    def __enter__(self) -> Self:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(self.folder, os.O_RDONLY)
        except OSError as error:
            raise UserError(
                f"{self.folder} cannot be written: {error.strerror}; choose another folder."
            ) from error
        try:
            with suppress(OSError):
                self._take(self._descriptor)
        except UserError:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let other processes write to the folder."""
        if self._descriptor is not None:
            os.close(self._descriptor)
        self._descriptor = None

    def _take(self, descriptor: int) -> None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UserError(
                f"{self.folder} is in use by another process of fluidsnet; wait until it ends, or "
                "choose another folder."
            ) from error

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_descriptor": None}


_LOCKS: WeakSet[FolderLock] = WeakSet()


def _let_go() -> None:
    for lock in _LOCKS:
        lock.close()


# Workers that outlive a killed process for a moment must not keep its folder.
os.register_at_fork(after_in_child=_let_go)
