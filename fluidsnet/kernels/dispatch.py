"""Choice between a compiled kernel and plain torch."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from torch import Tensor, nn

_disabled = ContextVar("fluidsnet_kernels_disabled", default=False)


@contextmanager
def disabled() -> Iterator[None]:
    """Run all blocks in plain torch inside this context; other threads are not affected."""
    token = _disabled.set(True)
    try:
        yield
    finally:
        _disabled.reset(token)


def use_kernel(block: nn.Module, *inputs: Tensor, differentiable: bool = False) -> bool:
    """Return whether a block takes its kernel: float32 on the CPU, outside torch.compile.

    Args:
        block: Block whose weights the kernel reads.
        inputs: Tensors that the kernel reads, weights excluded.
        differentiable: The kernel computes gradients of the weights, though not of the inputs.
            By default it computes none, and is taken only where none are needed.
    """
    # torch.compile cannot trace a kernel, and fuses the plain operations itself.
    if torch.compiler.is_compiling() or _disabled.get():
        return False
    if any(values.device.type != "cpu" or values.dtype != torch.float32 for values in inputs):
        return False
    if differentiable:
        return not any(values.requires_grad for values in inputs)
    return not torch.is_grad_enabled() or not any(
        values.requires_grad for values in (*inputs, *block.parameters())
    )
