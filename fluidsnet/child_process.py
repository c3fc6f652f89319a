"""Command of a Python process that imports what this one would."""

from __future__ import annotations

import sys
from pathlib import Path


def python_module(name: str) -> list[str]:
    """Return the command that runs a module as a script; arguments are appended to it.

    ``python -m`` would import from the working folder first, where data of strangers may lie, with
    files such as ``h5py.py``.

    Args:
        name: Such as ``datamodules.generate.solver``.
    """
    return [*python_code(f"import runpy; runpy.run_module({name!r}, None, '__main__', True)")]


def python_code(code: str) -> list[str]:
    """Return the command that runs Python code; arguments are appended to it."""
    # The working folder is the empty path.
    path = [entry for entry in sys.path if entry]
    package = str(Path(__file__).parents[1])
    path += [package] if package not in path else []
    return [sys.executable, "-P", "-c", f"import sys; sys.path[:] = {path!r}\n{code}"]
