"""Dense layers over columns, compiled: many numbers of one unit side by side."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from fluidsnet.features.tanh import tanh

#: Units whose part in an output is added at once: as many as leave registers free.
UNITS = 8
#: Columns are best a multiple of it, which is what a vectorised loop takes at a time; rows of
#: columns best differ from a power of two, or they share few places in the cache.
LANES = 32


def padded(weight: Tensor) -> NDArray[np.float32]:
    """A layer's weight (O, I) with zeros for units that only fill up, (O, I rounded up)."""
    missing = -weight.shape[1] % UNITS
    return as_array(torch.nn.functional.pad(weight, (0, missing)))


def as_array(values: Tensor) -> NDArray[np.float32]:
    """A tensor's numbers in float32, one row after another."""
    array: NDArray[np.float32] = values.detach().float().contiguous().numpy()
    return array


_plain = False


@contextmanager
def plain_torch() -> Iterator[None]:
    """Has every block take the path in plain torch that it is trained on, as on a GPU.

    For who wants to know what the compiled loops change. Not for several threads at once.
    """
    global _plain
    before, _plain = _plain, True
    try:
        yield
    finally:
        _plain = before


def compiled_path_for(values: Tensor) -> bool:
    """Whether to take a path that has no backward pass and knows the CPU and float32 alone."""
    return (
        not _plain
        and not torch.is_grad_enabled()
        and values.device.type == "cpu"
        and values.dtype == torch.float32
        # torch.compile cannot look into these loops; it makes its own of the plain operations.
        and not torch.compiler.is_compiling()
    )


@njit(cache=True, error_model="numpy")
def rounded_up(number: int, multiple: int) -> Any:
    """The least multiple that is no less."""
    return -(-number // multiple) * multiple


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_units(weight: Any, columns: Any, out: Any) -> None:
    """Adds a unit's weight (I,) times the columns (I, E) to it, (E,); I a multiple of `UNITS`."""
    for i in range(0, len(weight), UNITS):
        a, b, c, d = weight[i], weight[i + 1], weight[i + 2], weight[i + 3]
        f, g, h, j = weight[i + 4], weight[i + 5], weight[i + 6], weight[i + 7]
        col_a, col_b, col_c, col_d = columns[i], columns[i + 1], columns[i + 2], columns[i + 3]
        col_f, col_g, col_h, col_j = columns[i + 4], columns[i + 5], columns[i + 6], columns[i + 7]
        for e in range(len(out)):
            low = a * col_a[e] + b * col_b[e] + c * col_c[e] + d * col_d[e]
            high = f * col_f[e] + g * col_g[e] + h * col_h[e] + j * col_j[e]
            out[e] += low + high


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def squash(values: Any) -> None:
    """Tanh in place, (E,)."""
    for e in range(len(values)):
        values[e] = tanh(values[e])


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def mean(values: Any) -> Any:
    """Mean of (E,), added up in any order."""
    total = np.float32(0.0)
    for e in range(len(values)):
        total += values[e]
    return total / np.float32(len(values))
