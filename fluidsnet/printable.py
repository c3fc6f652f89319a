"""Text of files that strangers wrote, made safe for a terminal."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""Return a text with control characters other than the newline written as escapes.

    A terminal obeys them: they can hide lines, change its title or type into it. ESC becomes
    ``\x1b``.
    """
    return "".join(
        character
        if character.isprintable() or character == "\n"
        else character.encode("unicode_escape").decode()
        for character in text
    )
