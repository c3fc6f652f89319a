"""SPH data: the file format, the data module that reads it, the solver that makes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from datamodules.sph import SPHDataModule as SPHDataModule

__all__ = ["SPHDataModule"]


def __getattr__(name: str) -> Any:
    # Loaded on first use: the solver's processes import this package and need no torch.
    if name == "SPHDataModule":
        from datamodules.sph import SPHDataModule

        return SPHDataModule
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
