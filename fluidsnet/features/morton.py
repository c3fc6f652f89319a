"""Morton keys: a frame and the three coordinates of a cell in one integer.

The bits of x, y and z alternate, so the eight cells of a coarser cell have consecutive keys, and
its own key is theirs without the last three bits.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

# Shifts and masks that move the bits of a number of up to 21 bits three places apart.
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def coordinate_bits(frames: int) -> int:
    """Return the number of bits that a key has for each coordinate, at most 20.

    Args:
        frames: Number of frames in the batch.
    """
    return (63 - frames.bit_length()) // 3


def encode(coordinate: Tensor, frame: Tensor, bits: int) -> Tensor:
    """Return the keys (K,) of cells.

    Args:
        coordinate: (K, 3) int64, each 0 to 2^bits - 1.
        frame: (K,) int64.
        bits: Bits for each coordinate.
    """
    for shift, mask in _SPREAD:
        coordinate = (coordinate | coordinate << shift) & mask
    x, y, z = coordinate.unbind(dim=1)
    return frame << 3 * bits | z << 2 | y << 1 | x


def keys_around(key: Tensor, steps: Sequence[int], bits: int) -> Tensor:
    """Return the keys of cells beside cells, (K, len(steps)³), with x the fastest.

    Args:
        key: (K,) keys.
        steps: Steps of -1, 0 or 1 along each axis.
        bits: Bits for each coordinate; none may leave its range.
    """
    around = key[:, None]
    for axis in range(3):
        moved = [_stepped(around, axis, step, bits) for step in steps]
        around = torch.stack(moved, dim=1).flatten(1)
    return around


def _stepped(key: Tensor, axis: int, step: int, bits: int) -> Tensor:
    """Return the keys one step away along an axis, in which its bits alone are changed."""
    mask = sum(1 << 3 * bit for bit in range(bits)) << axis
    if step == 0:
        return key
    # The other bits are set or cleared, so that a carry or a borrow passes through them.
    stepped = (key | ~mask) + (1 << axis) if step > 0 else (key & mask) - (1 << axis)
    return key & ~mask | stepped & mask
