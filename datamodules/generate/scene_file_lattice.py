"""Particles of a scene file on lattices, where the solver is not installed to sample it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.bodies import Block, turned, vector
from datamodules.generate.lattice import block_lattice, enclosed_lattice, surface_lattice
from datamodules.generate.obj import read_faces, read_obj
from datamodules.generate.shapes import Points
from fluidsnet.errors import UserError

_REMEDY = "install it with `pip install 'fluidsnet[solver]'`"


@final
@dataclass(frozen=True)
class Sampled:
    """Particles of a scene.

    Attributes:
        position: (N, 3) of the fluid, m.
        velocity: (N, 3) of the fluid, m/s.
        solids: (M, 3) of each rigid body, m.
    """

    position: Points
    velocity: Points
    solids: list[Points]


def sample_scene_file(path: Path, content: dict[str, Any], particle_radius: float) -> Sampled:
    """Return the particles of a scene in SPlisHSPlasH's format.

    Fluid is on a cubic lattice at rest density, solids on a lattice of each triangle.

    Args:
        path: The scene file; names of files in it are relative to its folder.
        content: Its JSON values.
        particle_radius: m.

    Raises:
        UserError: The scene has what only the solver can sample, or a mesh cannot be read.
    """
    if content["Configuration"].get("sim2D"):
        raise UserError(f"{path}: only the solver samples scenes in two dimensions; {_REMEDY}.")
    fluid = [_block(it, particle_radius) for it in content.get("FluidBlocks", [])]
    for model in content.get("FluidModels", []):
        vertices, triangles = read_obj(_obj(path, model["particleFile"]))
        placed = _placed(model, vertices)
        fluid.append((enclosed_lattice(placed, triangles, particle_radius), _velocity(model)))
    solids = []
    for body in content.get("RigidBodies", []):
        vertices, triangles = read_faces(_obj(path, body["geometryFile"]))
        solids.append(surface_lattice(_placed(body, vertices), triangles, particle_radius))
    return Sampled(
        np.concatenate([points for points, _ in fluid]),
        np.concatenate([np.broadcast_to(speed, points.shape) for points, speed in fluid]),
        solids,
    )


def _block(described: dict[str, Any], particle_radius: float) -> tuple[Points, Points]:
    """Return particles (P, 3), m, and velocity (3,), m/s, of a block."""
    scale = np.array(described.get("scale", [1.0, 1.0, 1.0]), float)
    shift = np.array(described.get("translation", [0.0, 0.0, 0.0]), float)
    lower, upper = (scale * np.array(described[name], float) + shift for name in ("start", "end"))
    # SPlisHSPlasH leaves one spacing empty at each end of a block.
    block = Block(vector(lower + particle_radius), vector(upper - particle_radius))
    return block_lattice(block, particle_radius), _velocity(described)


def _velocity(described: dict[str, Any]) -> NDArray[np.float64]:
    return np.array(described.get("initialVelocity", [0.0, 0.0, 0.0]), float)


def _placed(described: dict[str, Any], vertices: Points) -> Points:
    """Return vertices (V, 3) scaled, turned and moved as a model or a body of the scene."""
    angle = float(described.get("rotationAngle", 0.0))
    axis = np.array(described.get("rotationAxis", [1.0, 0.0, 0.0]), float)
    axis *= np.sin(angle / 2) / max(float(np.linalg.norm(axis)), 1e-12)
    x, y, z = axis.tolist()
    scaled = vertices * np.array(described.get("scale", [1.0, 1.0, 1.0]), float)
    moved: Points = turned(scaled, (float(np.cos(angle / 2)), x, y, z))
    moved += np.array(described.get("translation", [0.0, 0.0, 0.0]), float)
    return moved


def _obj(path: Path, name: str) -> Path:
    """Return the path of an OBJ file that a scene names."""
    if Path(name).suffix.lower() != ".obj":
        raise UserError(f"{path}: only the solver reads {name}; {_REMEDY}.")
    return (path.parent / name).resolve()
