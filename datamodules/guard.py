"""Time limit for reading a file that may be damaged."""

from __future__ import annotations

import faulthandler
import os
import signal
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from fluidsnet.errors import UserError

#: Longest time that opening a file may take, s.
LIMIT = 30.0


def guarded(path: Path, read: Callable[[], object]) -> None:
    """Try in a child process whether reading a file ends.

    HDF5 follows loops in a damaged file for ever, and nothing in the process can stop it.

    Args:
        path: File, for the message.
        read: Reads the file; what it returns or raises is ignored.

    Raises:
        UserError: It does not end within `LIMIT`, or ends the process.
    """
    with warnings.catch_warnings():
        # The child runs HDF5 alone, no thread of this process.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        faulthandler.disable()
        try:
            read()
        finally:
            os._exit(0)
    deadline, pause = time.monotonic() + LIMIT, 1e-4
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise UserError(
                f"{path}: opening it takes more than {LIMIT:g} s, so its structure is damaged, or "
                "the disk does not answer."
            )
        time.sleep(pause)
        pause = min(2 * pause, 0.02)
    if os.WIFSIGNALED(status):
        raise UserError(f"{path}: the file is damaged: HDF5 crashes when it opens it.")
