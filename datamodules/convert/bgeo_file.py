"""Points of a Houdini BGEO file of version 5, as Partio and SPlisHSPlasH write it.

All numbers are big-endian and four bytes long: a header, the definitions of the attributes, then
for each point x, y, z, w and its attributes. Partio compresses the file with gzip.
"""

from __future__ import annotations

import gzip
import struct
from io import BytesIO
from pathlib import Path

import numpy as np

from datamodules.convert.points import Points
from fluidsnet.errors import UserError

_FLOAT, _INTEGER, _INDEX, _VECTOR = 0, 1, 4, 5  # types of attributes


def read_bgeo(path: Path) -> Points:
    """Read positions and attributes of the points.

    Raises:
        UserError: The file is damaged, or of another format or version.
    """
    try:
        with path.open("rb") as raw:
            compressed = raw.read(2) == b"\x1f\x8b"
        with gzip.open(path) if compressed else path.open("rb") as file:
            # Whole, so that a count that is not true asks for no memory.
            return _read(BytesIO(file.read()))
    except (OSError, EOFError, ValueError, TypeError, struct.error) as error:
        raise UserError(
            f"{path}: it cannot be read as BGEO of version 5, Houdini's classic format: {error}."
        ) from error


def _read(file: BytesIO) -> Points:
    if file.read(5) != b"BgeoV":
        raise ValueError("it does not begin with BgeoV")
    version, count, _, _, _, attributes, *_ = struct.unpack(">9i", _exactly(file, 36))
    if version != 5:
        raise ValueError(f"its version is {version}")
    columns: list[tuple[str, str, int]] = [("homogeneous position", ">f4", 4)]
    for _ in range(attributes):
        name = _text(file)
        size, kind = struct.unpack(">Hi", _exactly(file, 6))
        if kind == _INDEX:
            for _ in range(struct.unpack(">i", _exactly(file, 4))[0]):
                _text(file)
        elif kind in (_FLOAT, _INTEGER, _VECTOR):
            _exactly(file, 4 * size)  # default values
        else:
            raise ValueError(f"attribute {name!r} has the unknown type {kind}")
        columns.append((name, ">f4" if kind in (_FLOAT, _VECTOR) else ">i4", size))
    layout = np.dtype([(name, kind, (size,)) for name, kind, size in columns])
    points = np.frombuffer(_exactly(file, count * layout.itemsize), layout)
    fields = {name: points[name] for name, _, _ in columns[1:]}
    return Points(points[columns[0][0]][:, :3], {name: it.squeeze() for name, it in fields.items()})


def _exactly(file: BytesIO, count: int) -> bytes:
    data = file.read(count) if count >= 0 else b""
    if len(data) != count:
        raise ValueError("it ends too early")
    return data


def _text(file: BytesIO) -> str:
    (length,) = struct.unpack(">H", _exactly(file, 2))
    return _exactly(file, length).decode("latin-1")
