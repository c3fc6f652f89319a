"""Types of the blocks that a model is composed from."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import FunctionType, UnionType
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin, get_type_hints

from fluidsnet.model import BLOCKS, Model

_TYPES = {name: get_type_hints(Model.__init__)[name] for name in BLOCKS}
# A model without one of the others gets its default.
_OPTIONAL = {"noise"}

if TYPE_CHECKING:
    Block = Any
else:
    # jsonargparse can save a list of widths only if its type is the first of the union.
    #: Type of any block, for configs.
    Block = Union[(list[int], *_TYPES.values())]


def can_be(name: str, value: Any) -> bool:
    """Return whether a value can be the block of this name.

    Args:
        name: One of `BLOCKS`.
        value: Block, or a recipe for it where the model builds it.
    """
    if value is None:
        return name in _OPTIONAL
    hint = _TYPES[name]
    for kind in get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,):
        kind = get_origin(kind) or kind
        if kind is Callable:
            # Blocks can be called, too.
            if isinstance(value, type | partial | FunctionType):
                return True
        elif isinstance(value, kind) and not isinstance(value, str):
            return True
    return False
