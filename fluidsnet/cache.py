"""What was made of tensors, kept for as long as they hold the same numbers."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar, final

import torch
from torch import Tensor

T = TypeVar("T")


@final
class TensorCache(Generic[T]):
    """Remembers one result, and the tensors it was made of.

    Numbers are compared, not tensors: a version counter misses a change through NumPy, does
    not exist in inference mode, and a new copy of the same solids would count as new. Reading
    them is far cheaper than sorting them.
    """

    def __init__(self) -> None:
        self._made: tuple[tuple[Tensor, ...], Hashable, T] | None = None

    def get(self, tensors: tuple[Tensor, ...], settings: Hashable, make: Callable[..., T]) -> T:
        """``make(*tensors)``, or the last result where neither tensors nor settings differ."""
        if self._made is not None:
            known, known_settings, result = self._made
            if settings == known_settings and all(map(_same, known, tensors)):
                return result
        result = make(*tensors)
        self._made = (tuple(tensor.detach().clone() for tensor in tensors), settings, result)
        return result


def _same(known: Tensor, given: Tensor) -> bool:
    return known.device == given.device and known.dtype == given.dtype and torch.equal(known, given)
