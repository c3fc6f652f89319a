"""A closed surface of four triangles, for tests of meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datamodules.generate.obj import write_obj

VERTICES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def write_tetrahedron(path: Path) -> None:
    """Write it as an OBJ file."""
    write_obj(path, VERTICES, TRIANGLES + 1)
