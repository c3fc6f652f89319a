"""Houdini's classic BGEO files (version 5), as Partio and SPlisHSPlasH write them.

Layout, all big-endian, compressed with gzip::

    "BgeoV", version = 5                                       5 bytes, int32
    points, primitives, point groups, primitive groups         int32 each
    point, vertex, primitive, detail attributes                int32 each
    per point attribute: length of its name, name              uint16, bytes
                         size, type, default                   uint16, int32, 4 bytes × size
    per point: x, y, z, 1, then its attributes                 4 bytes each
    0x00 0xff                                                  end
"""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np

from fluidsnet.export.frames import Frame

_INTEGER, _VECTOR = 1, 5
#: Point attributes: name, size and type.
_ATTRIBUTES = (("velocity", 3, _VECTOR), ("id", 1, _INTEGER))
_POINT = np.dtype(
    [("position", ">f4", 3), ("weight", ">f4"), ("velocity", ">f4", 3), ("id", ">i4")]
)


def write_bgeo(path: Path, frame: Frame) -> None:
    """Write position (m), velocity (m/s) and id of the particles of a frame.

    Positions are float32: the format has no wider numbers.
    """
    header = [b"BgeoV", struct.pack(">9i", 5, len(frame.position), 0, 0, 0, 2, 0, 0, 0)]
    for name, size, kind in _ATTRIBUTES:
        header.append(struct.pack(f">H{len(name)}s", len(name), name.encode()))
        header.append(struct.pack(f">Hi{4 * size}x", size, kind))
    points = np.zeros(len(frame.position), _POINT)
    points["position"], points["weight"] = frame.position, 1.0
    points["velocity"], points["id"] = frame.velocity, frame.ids
    content = b"".join([*header, points.tobytes(), b"\x00\xff"])
    # Without the time of writing, equal frames are equal files.
    path.write_bytes(gzip.compress(content, compresslevel=1, mtime=0))
