"""What the processes of a run that trains together, as Lightning's DDP does, add up."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, distributed


def processes() -> int:
    """How many processes train together: one, unless torch.distributed has more."""
    together = distributed.is_available() and distributed.is_initialized()
    return distributed.get_world_size() if together else 1


def sum_over_processes(values: Tensor) -> Tensor:
    """The sum over all processes, the same in each, with a gradient; of any shape.

    All must call it as often as each other, with tensors of one shape and type. Its gradient is
    that of what all processes make of it together.
    """
    if processes() == 1:
        return values
    result: Tensor = _Sum.apply(values)  # type: ignore[no-untyped-call]
    return result


class _Sum(torch.autograd.Function):
    """An all-reduce whose backward is one too; torch's own of this kind is deprecated."""

    @staticmethod
    def forward(context: Any, values: Tensor) -> Tensor:
        return _sum(values)

    @staticmethod
    def backward(context: Any, *gradients: Tensor) -> Tensor:
        return _sum(gradients[0])


def _sum(values: Tensor) -> Tensor:
    result = values.clone(memory_format=torch.contiguous_format)
    distributed.all_reduce(result)
    return result
