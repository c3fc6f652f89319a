"""The same random numbers for models that are compared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import TypeVar, final

import torch
from torch import Tensor

T = TypeVar("T")


@final
class Draws(AbstractContextManager[None]):
    """The random numbers that will be drawn next: after the block, they are those before it.

    It copies the states of the generators of the CPU and of a GPU; neither makes a GPU wait.

    Args:
        device: that draws, beside the CPU.
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        self._device = torch.device(device)
        self._cpu: Tensor = torch.get_rng_state()
        self._cuda = torch.cuda.get_rng_state(self._device) if self._device.type == "cuda" else None

    def restore(self) -> None:
        """Goes back to where the numbers were when this was made."""
        torch.set_rng_state(self._cpu)
        if self._cuda is not None:
            torch.cuda.set_rng_state(self._cuda, self._device)

    def __exit__(self, *_: object) -> None:
        self.restore()


def alike(device: torch.device, calls: Sequence[Callable[[], T]]) -> list[T]:
    """Calls each with the same random numbers to come; what follows sees the first call alone.

    Args:
        device: that they draw on.
        calls: one or more.
    """
    if len(calls) == 1:
        return [calls[0]()]
    before = Draws(device)
    results = [calls[0]()]
    with Draws(device):
        for call in calls[1:]:
            before.restore()
            results.append(call())
    return results
