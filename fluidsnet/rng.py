"""Random number generator state: save and restore it, or give it to several calls."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
import torch

T = TypeVar("T")


@contextmanager
def preserve_rng_state(device: torch.device | str = "cpu") -> Iterator[None]:
    """Restore the generators of the CPU and of a CUDA device when the block ends.

    Copying the states does not make a GPU wait.

    Args:
        device: Device whose generator is preserved beside that of the CPU.
    """
    device = torch.device(device)
    with torch.random.fork_rng([device] if device.type == "cuda" else []):
        yield


def with_same_rng(device: torch.device, calls: Sequence[Callable[[], T]]) -> list[T]:
    """Call functions that each draw the same random numbers; return their results.

    Afterward the generators are where the first call alone would have left them.

    Args:
        device: Device that the functions draw on.
        calls: One or more functions.
    """
    *others, last = [*calls[1:], calls[0]]
    results = []
    for call in others:
        with preserve_rng_state(device):
            results.append(call())
    return [last(), *results]


def derived_seed(*numbers: int) -> int:
    """Return a seed that depends on numbers, such as a seed, a process and a step.

    Args:
        numbers: Not negative.
    """
    # PyTorch's generator on the CPU uses the lower 32 bits, and sequences need 63.
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])
