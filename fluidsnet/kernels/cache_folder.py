"""Folder of the compiled kernels on disk."""

from __future__ import annotations

from pathlib import Path

from numba import config

from fluidsnet.kernels.search import _flatten


def cache_folder() -> Path | None:
    """Return the folder of the compiled kernels, which may not exist yet.

    It is None where numba is told to compile nothing, by ``NUMBA_DISABLE_JIT``.
    """
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return None
    path = _flatten.stats.cache_path
    return None if path is None else Path(path)
