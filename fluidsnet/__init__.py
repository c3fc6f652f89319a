"""FluidsNet: learn a fluid from the particles of an SPH simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fluidsnet.module import FluidsNet as FluidsNet

__all__ = ["FluidsNet"]


def __getattr__(name: str) -> Any:
    # Loaded on first use: the solver's processes import this package and need no torch.
    if name == "FluidsNet":
        from fluidsnet.module import FluidsNet

        return FluidsNet
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
