"""Room on a disk, checked before HDF5 writes: where it has none, it may crash the process."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

from fluidsnet.errors import UserError

# For what HDF5 writes beside the data, and when it closes the file, bytes.
_SPARE = 2**20


def check_space(path: Path, needed: int = 0, kept: str = "") -> None:
    """Check that the disk of a file has room for what is to be written.

    What HDF5 holds in its caches is not on the disk yet; flush the file before.

    Args:
        path: File in a folder that exists.
        needed: Size of the data, bytes.
        kept: End of the sentence, such as what is kept.

    Raises:
        UserError: It has not.
    """
    if shutil.disk_usage(path.parent).free < needed + _SPARE:
        raise UserError(f"{path} cannot be written: {os.strerror(errno.ENOSPC)}{kept}.")
