"""Files of particle positions in the format BGEO, which SPlisHSPlasH reads."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def write_bgeo(path: Path, position: NDArray[np.float64]) -> None:
    """Write positions (N, 3), m, as the points of a Houdini BGEO file, version 5."""
    # The counts after the points are of primitives, groups and attributes; there are none.
    counts = struct.pack(">8i", len(position), *[0] * 7)
    homogeneous = np.concatenate([position, np.ones((len(position), 1))], axis=1)
    with path.open("wb") as file:
        file.write(b"BgeoV" + struct.pack(">i", 5) + counts)
        file.write(homogeneous.astype(">f4").tobytes())
        file.write(b"\x00\xff")  # end of the file
