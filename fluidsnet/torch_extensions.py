"""Operators of torch-scatter and torch-cluster; the only module that imports them.

Both are compiled from source. Without them each operator raises a `UserError` when it is called:
the kernels of the CPU and the models that ship need none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn

from fluidsnet.errors import UserError

#: Packages that cannot be imported, and why.
MISSING: dict[str, Exception] = {}
#: Command that installs both beside an installed torch.
COMMAND = "pip install torch-cluster torch-scatter --no-build-isolation"


def _missing(package: str, error: Exception) -> Callable[..., NoReturn]:
    """Return a stand-in for the operators of a package that cannot be imported."""
    MISSING[package] = error

    def operator(*_: Any, **__: Any) -> NoReturn:
        raise UserError(
            f"This needs the package {package}, which cannot be loaded ({error}); run "
            f"`make setup` in a checkout, or `{COMMAND}`."
        ) from error

    return operator


# A wheel for another torch raises an OSError or a RuntimeError.
try:
    from torch_scatter import gather_csr, segment_csr
except (ImportError, OSError, RuntimeError) as error:
    gather_csr = segment_csr = _missing("torch-scatter", error)
try:
    from torch_cluster import knn
except (ImportError, OSError, RuntimeError) as error:
    knn = _missing("torch-cluster", error)

__all__ = ["COMMAND", "MISSING", "gather_csr", "knn", "segment_csr"]
