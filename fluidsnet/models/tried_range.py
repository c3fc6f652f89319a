"""Scenes that a shipped model was tried on: its file ``range.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import final

import yaml

from fluidsnet.models.shipped import is_shipped, run_path


@final
@dataclass(frozen=True)
class TriedRange:
    """Scenes that a model was trained or tried on.

    Attributes:
        particle_radius: m.
        depth: Greatest depth of water, m.
        speed: Greatest speed, m/s.
    """

    particle_radius: float
    depth: float
    speed: float


def shipped_range(run: str | Path) -> TriedRange | None:
    """Return the range of a shipped model; None of another."""
    if not is_shipped(run):
        return None
    return TriedRange(**yaml.safe_load((run_path(run) / "range.yaml").read_text()))
