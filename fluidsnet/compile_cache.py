"""Folder of compiled kernels where numba can write to none of its default folders."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def set_compile_cache() -> None:
    """Set ``NUMBA_CACHE_DIR`` if neither the package nor the home folder can be written.

    numba raises an error there, as for a user without a home and with a read-only checkout.
    """
    if os.name != "posix" or "NUMBA_CACHE_DIR" in os.environ:
        return
    if os.access(Path(__file__).parent, os.W_OK) or os.access(os.path.expanduser("~"), os.W_OK):
        return
    folder = Path(tempfile.gettempdir()) / f"fluidsnet-numba-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    # Compiled code is loaded from it: it must not be another user's.
    if folder.lstat().st_uid == os.getuid():
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
