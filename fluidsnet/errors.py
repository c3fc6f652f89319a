"""The one error that is meant for the person at the keyboard."""

from __future__ import annotations


class UserError(Exception):
    """Input that cannot be used; the message says in one sentence what to do about it.

    The command line prints the message alone and ends with a non-zero status.
    """
