"""Batch: base of the dataclasses of tensors that are moved to a device and collated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import accumulate, chain
from typing import Any, Self

import torch
from torch import Tensor


@dataclass(frozen=True)
class Movable:
    """Base of the dataclasses that hold tensors: moves all of them at once."""

    def to(self, device: torch.device | str, non_blocking: bool = False) -> Self:
        """Return a copy on a device."""
        return self._each(lambda value: value.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> Self:
        """Return a copy in page-locked memory, for an asynchronous copy to a GPU."""
        return self._each(lambda value: value.pin_memory())

    def _each(self, change: Callable[[Any], Any]) -> Self:
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return replace(
            self,
            **{n: change(value) for n, value in values.items() if isinstance(value, _MOVABLE)},
        )


_MOVABLE = (Tensor, Movable)


@dataclass(frozen=True)
class Batch(Movable):
    """Base of the batches. Each field's metadata has `join`: how its values are collated."""

    @classmethod
    def collate(cls, batches: Sequence[Self]) -> Self:
        """Join batches into one, in the order given.

        Raises:
            ValueError: there is no batch, or two of them differ in a value that a batch has
                once, such as the time step, in number of steps, dtype or device.
        """
        if not batches:
            raise ValueError(f"cannot collate {cls.__name__}: there are no batches to join")
        return cls(
            **{entry.name: entry.metadata["join"](batches, entry.name) for entry in fields(cls)}
        )


def _concatenate(batches: Sequence[Any], name: str, axis: int = 0) -> Tensor:
    return torch.cat(_tensors(batches, name, axis), dim=axis)


def _frame_index(batches: Sequence[Any], name: str) -> Tensor:
    offsets = accumulate((batch.frames for batch in batches[:-1]), initial=0)
    frames = _tensors(batches, name, axis=0)
    return torch.cat([frame + offset for frame, offset in zip(frames, offsets, strict=True)])


def _tensors(batches: Sequence[Any], name: str, axis: int) -> list[Tensor]:
    """Return a field of each batch, and check that the tensors can be joined along an axis."""
    tensors: list[Tensor] = [getattr(batch, name) for batch in batches]
    first = tensors[0]
    for other in tensors[1:]:
        for what, one, two in (
            ("dtype", first.dtype, other.dtype),
            ("device", first.device, other.device),
            ("shape", _shape(first, axis), _shape(other, axis)),
        ):
            if one != two:
                raise ValueError(f"cannot collate {name}: its {what} is {one} and {two}")
    return tensors


def _shape(tensor: Tensor, axis: int) -> str:
    """Return the shape as text, with N for the axis that tensors are joined along."""
    sizes = (str(size) for size in tensor.shape)
    return f"({', '.join('N' if at == axis else size for at, size in enumerate(sizes))})"


def _sum(batches: Sequence[Any], name: str) -> int:
    return sum(getattr(batch, name) for batch in batches)


def _chain(batches: Sequence[Any], name: str) -> tuple[Any, ...]:
    return tuple(chain.from_iterable(getattr(batch, name) for batch in batches))


def _equal(batches: Sequence[Any], name: str) -> Any:
    value, *others = (getattr(batch, name) for batch in batches)
    for other in others:
        if other != value:
            raise ValueError(f"cannot collate states: their {name} is {value} and {other}")
    return value


def _any(batches: Sequence[Any], name: str) -> bool:
    return any(getattr(batch, name) for batch in batches)


def _collate(batches: Sequence[Any], name: str) -> Any:
    parts = [getattr(batch, name) for batch in batches]
    return type(parts[0]).collate(parts)


def _collate_optional(batches: Sequence[Any], name: str) -> Any:
    missing = [getattr(batch, name) is None for batch in batches]
    if any(missing) and not all(missing):
        raise ValueError(f"cannot collate {name}: only some of the batches have it")
    return None if all(missing) else _collate(batches, name)


#: Metadata of a tensor with a row per particle or frame.
ROWS: dict[str, Any] = {"join": _concatenate}
#: Metadata of a tensor with a row per step, and a column per particle.
STEPS_AND_ROWS: dict[str, Any] = {"join": partial(_concatenate, axis=1)}
#: Metadata of a tensor of frame numbers, counted on from batch to batch.
FRAME_INDEX: dict[str, Any] = {"join": _frame_index}
#: Metadata of a tuple with an entry per frame.
ENTRIES: dict[str, Any] = {"join": _chain}
#: Metadata of a count that is added up.
COUNT: dict[str, Any] = {"join": _sum}
#: Metadata of a value that all batches must share.
SHARED: dict[str, Any] = {"join": _equal}
#: Metadata of a flag that holds for a batch if it holds for one of its parts.
ANY: dict[str, Any] = {"join": _any}
#: Metadata of a part that is a batch itself.
PART: dict[str, Any] = {"join": _collate}
#: Metadata of a part that all batches have, or none.
OPTIONAL_PART: dict[str, Any] = {"join": _collate_optional}
