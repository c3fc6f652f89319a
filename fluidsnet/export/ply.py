"""PLY files of particles, binary."""

from __future__ import annotations

from pathlib import Path

from fluidsnet.export.frames import Frame
from fluidsnet.export.optional import load_optional


def write_ply(path: Path, frame: Frame) -> None:
    """Write the particles of a frame as vertices with x, y, z (m), vx, vy, vz (m/s) and id.

    Positions keep their type, float32 or float64.

    Raises:
        UserError: meshio is not installed.
    """
    meshio = load_optional("meshio", "meshio")
    velocity = dict(zip(("vx", "vy", "vz"), frame.velocity.T, strict=True))
    particles = meshio.Mesh(frame.position, [], point_data={**velocity, "id": frame.ids})
    meshio.write(path, particles, file_format="ply", binary=True)
