"""Import of packages that only the export needs."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from fluidsnet.errors import UserError


def load_optional(module: str, package: str) -> ModuleType:
    """Import a module of the extra ``export``.

    Args:
        module: Name of the module, such as ``pxr.Usd``.
        package: Name of its package on PyPI.

    Raises:
        UserError: It cannot be imported.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise UserError(
            f"The package {package} cannot be loaded ({error}); install it with "
            "`pip install 'fluidsnet[export]'`."
        ) from error
