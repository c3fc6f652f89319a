"""What an overlay is put upon where the command line does not say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from fluidsnet.errors import UserError


def with_base(arguments: list[str]) -> list[str]:
    """Puts before the first ``--config`` the files that it names as its ``base``.

    An overlay, such as those in `configs/ablation`, changes a composition. Where it comes first,
    nothing to change was named, and its own base is: a list of files, relative to its folder.
    Where it comes after others, its base is theirs.

    Args:
        arguments: a command and its options.

    Raises:
        UserError: the base is no list of files that exist.
    """
    for place, word in enumerate(arguments):
        if word == "--config" and place + 1 < len(arguments):
            overlay = Path(arguments[place + 1])
        elif word.startswith("--config="):
            overlay = Path(word.removeprefix("--config="))
        else:
            continue
        base = [f"--config={path}" for path in _base(overlay)]
        return [*arguments[:place], *base, *arguments[place:]]
    return arguments


def _base(overlay: Path) -> list[Path]:
    try:
        values: Any = yaml.safe_load(overlay.read_text())
    except (OSError, UnicodeError, yaml.YAMLError):
        # The parser says it better, with the place in the file.
        return []
    named = values.get("base") if isinstance(values, dict) else None
    if named is None:
        return []
    if not isinstance(named, list) or not all(isinstance(name, str) for name in named):
        raise UserError(f"{overlay}: base is {named!r}; it must be a list of files.")
    paths = [overlay.parent / name for name in named]
    for path in paths:
        if not path.is_file():
            raise UserError(f"{overlay}: its base {path} is missing.")
    return paths
