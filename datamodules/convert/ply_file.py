"""Points of a PLY file (Stanford polygon format), ASCII or binary.

VTK's reader takes positions only, so the properties of the vertices are read here. Three
properties with the same name but for x, y, z at the end, such as ``vx``, ``vy``, ``vz``, are a
vector, ``v``.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from datamodules.convert.points import Points
from datamodules.convert.simulation import Array
from fluidsnet.errors import UserError

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


def read_ply(path: Path) -> Points:
    """Read positions and properties of the vertices.

    Raises:
        UserError: The file is damaged, or has no vertices first.
    """
    try:
        with path.open("rb") as file:
            count, layout, is_text = _header(file)
            if is_text:
                rows = np.loadtxt(file, max_rows=count, ndmin=2)[:, : len(layout.names or ())]
                columns = dict(zip(layout.names or (), rows.T, strict=True))
            else:
                vertices = np.fromfile(file, layout, count)
                columns = {name: vertices[name] for name in layout.names or ()}
        if any(len(column) != count for column in columns.values()):
            raise ValueError(f"it ends before its {count} vertices do")
        return _points(columns)
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise UserError(f"{path}: it cannot be read as PLY: {error}.") from error


def _header(file: BinaryIO) -> tuple[int, np.dtype[np.void], bool]:
    """Return number and layout of the vertices, and whether the file is text."""
    if file.readline().strip() != b"ply":
        raise ValueError("it does not begin with ply")
    order, count, element = "", 0, ""
    properties: list[tuple[str, str]] = []
    for line in file:
        words = line.decode("latin-1").split()
        if words[:1] == ["end_header"]:
            return count, np.dtype(properties), order == "="
        if words[:1] == ["format"]:
            order = _ORDERS[words[1]]
        elif words[:1] == ["element"]:
            if words[1] != "vertex" and not element:
                raise ValueError("its first element is not vertex")
            element = words[1]
            count = int(words[2]) if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex":
            if words[1] == "list":
                raise ValueError("its vertices have a list")
            properties.append((words[2], order + _TYPES[words[1]]))
    raise ValueError("its header does not end")


def _points(columns: dict[str, Array]) -> Points:
    """Return points from the properties by name, (N,) each."""
    vectors: dict[str, Array] = {}
    for name in columns:
        stem = name[:-1]
        if name.lower().endswith("x") and all(
            stem + axis in columns for axis in ("yz" if name[-1] == "x" else "YZ")
        ):
            axes = [name, *(stem + axis for axis in ("yz" if name[-1] == "x" else "YZ"))]
            vectors[stem.rstrip("_")] = np.stack([columns[axis] for axis in axes], axis=1)
    if "" not in vectors:
        raise ValueError("its vertices have no x, y and z")
    return Points(vectors.pop(""), {**columns, **vectors})
