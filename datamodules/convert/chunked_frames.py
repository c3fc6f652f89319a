"""Frames of an HDF5 data set whose chunks hold several of them."""

from __future__ import annotations

from collections.abc import Iterator

import h5py

from datamodules.convert.simulation import Array
from datamodules.schema import DAMAGE
from fluidsnet.errors import UserError

_BLOCK_BYTES = 64_000_000  # of frames in memory


def read_frames(dataset: h5py.Dataset) -> Iterator[Array]:
    """Yield the frames of a data set (T, N, dimension), reading each of its chunks once.

    Raises:
        UserError: One cannot be read.
    """
    most = max(_BLOCK_BYTES // max(dataset[0].nbytes, 1), 1)
    block = min(dataset.chunks[0] if dataset.chunks else most, most)
    try:
        for start in range(0, len(dataset), block):
            yield from dataset[start : start + block]
    except DAMAGE as error:
        raise UserError(f"{dataset.name} cannot be read; it is damaged ({error}).") from error
