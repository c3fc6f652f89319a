"""SPH data: the HDF5 file format, the data module that reads it, and the generator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from datamodules.sph import SPHDataModule as SPHDataModule

__all__ = ["SPHDataModule"]


def __getattr__(name: str) -> Any:
    # Imported on first use: solver processes import this package and do not need torch.
    if name == "SPHDataModule":
        from datamodules.sph import SPHDataModule

        return SPHDataModule
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
