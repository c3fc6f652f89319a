"""Error for input that cannot be used."""

from __future__ import annotations


class UserError(Exception):
    """Input that cannot be used; the message says what is wrong, where, and what to do.

    The command line prints the message without a traceback and exits with a non-zero status.
    """


class NotWritten(UserError):
    """An HDF5 file that could not be written, such as on a full disk.

    HDF5 writes it again when the process ends, fails again, and crashes: end it without that.

    Attributes:
        full: A disk, a quota or the size of a file is at its limit.
    """

    def __init__(self, message: str, full: bool = False) -> None:
        super().__init__(message)
        self.full = full
