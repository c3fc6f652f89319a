"""SPH data: the HDF5 file format, the data module that reads it, and the generator."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from datamodules.reader import read_motion as read_motion
    from datamodules.reader import read_state as read_state
    from datamodules.sph import SPHDataModule as SPHDataModule

__all__ = ["SPHDataModule", "read_motion", "read_state"]

_MODULES = {
    "SPHDataModule": "datamodules.sph",
    "read_motion": "datamodules.reader",
    "read_state": "datamodules.reader",
}


def __getattr__(name: str) -> Any:
    # Imported on first use: solver processes import this package and do not need torch.
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
