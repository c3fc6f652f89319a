"""Room on a disk, which is checked before HDF5 writes, and what HDF5 says where it has none."""

from __future__ import annotations

import errno
import os
import re
import shutil
from pathlib import Path

from fluidsnet.errors import NotWritten, UserError

# For what HDF5 writes beside the data, and when it closes the file, bytes.
_SPARE = 2**20
# In an error of HDF5, the file and the number of the system's error.
_WRITING = re.compile(r"filename = '([^']+)'.*errno = (\d+)", re.DOTALL)
# Where a disk, a quota or the size of a file is at its limit.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def check_space(path: Path, needed: int = 0, kept: str = "") -> None:
    """Check that the disk of a file has room for what is to be written.

    Where it has none, HDF5 may crash the process.
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


def not_written(error: BaseException | None, path: Path | None = None) -> NotWritten | None:
    """Return an error of HDF5 at writing in words; None for any other error.

    Args:
        error: Error.
        path: Name that the file is to get; by default the one that HDF5 writes.
    """
    found = _WRITING.search(str(error))
    if found is None:
        return None
    number = int(found[2])
    message = f"{path or found[1]} cannot be written: {os.strerror(number)}."
    return NotWritten(message, full=number in _FULL)
