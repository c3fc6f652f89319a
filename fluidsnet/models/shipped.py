"""Models that ship with the package: one folder each, beside this file.

A folder holds ``config.yaml``, as that of a run, and ``card.md``: data, metrics and limits.
"""

from __future__ import annotations

from pathlib import Path

_FOLDER = Path(__file__).parent


def shipped_models() -> list[str]:
    """Return the names of the models that ship with the package."""
    return sorted(path.parent.name for path in _FOLDER.glob("*/config.yaml"))


def is_shipped(run: str | Path) -> bool:
    """Return whether this names a shipped model; a folder of that name is ``./name``."""
    return str(run) in shipped_models()


def run_path(run: str | Path) -> Path:
    """Return the path that a name or path stands for: of a shipped model its folder."""
    return _FOLDER / run if is_shipped(run) else Path(run)
