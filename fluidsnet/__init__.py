"""FluidsNet: neural networks that simulate fluids, trained on SPH particle data."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fluidsnet.compile_cache import set_compile_cache

if TYPE_CHECKING:
    from fluidsnet.models import load as load
    from fluidsnet.module import FluidsNet as FluidsNet

__all__ = ["FluidsNet", "load"]

_MODULES = {"FluidsNet": "fluidsnet.module", "load": "fluidsnet.models"}

set_compile_cache()


def __getattr__(name: str) -> Any:
    # Imported on first use: the solver's processes import this package without torch.
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
