"""HDF5 file format: names, shapes, units and validation.

One file holds one split of a data set, one group of it one simulation::

    /                attributes: schema_version, scene, solver, ...  (Header)
    /00000/position  (T, N, 3) float32, m        one frame a chunk
    /00000/velocity  (T, N, 3) float32, m/s      one frame a chunk
    /00000/time      (T,) float64, s
    /00000/solver_seconds  (T,) float64, s       the solver's wall time for a frame's steps
    /00000/solid_position  (M, 3) float32, m     (T, M, 3) where solids move
    /00000/solid_velocity  (T, M, 3) float32, m/s  only where solids move
    /00000/          attributes, none of them needed: seed, scene_parameters (JSON), threads

Row i is the same particle in every frame.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np

from fluidsnet.errors import UserError

SCHEMA_VERSION = 1

#: Splits of a data set; each has a file.
SPLITS = ("train", "val", "test")

#: Filters that every h5py build reads. Gzip at level 1 keeps 76 % of the bytes of a frame of a
#: dam break and writes 4,900 particles in 1.8 ms; level 9 takes 3.0 ms for 75 %, lzf 0.7 ms for
#: 81 % (median of 13 frames, three times, each written to memory on one core).
COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}

#: Exceptions that h5py raises for a damaged file.
DAMAGE = (OSError, KeyError, RuntimeError)

#: Attributes of three numbers.
VECTORS = ("domain_lower", "domain_upper", "gravity")
_FLOATS = ("particle_radius", "support_radius", "dt", "density0", "viscosity")


@dataclass(frozen=True)
class Header:
    """Attributes of a file.

    Attributes:
        scene: Name of the scene kind.
        solver: Name of the pressure solver.
        solver_version: Version of the solver's program.
        solver_parameters: Parameters of the solver, under the solver's names.
        domain_lower, domain_upper: Corners of the box, m.
        gravity: m/s².
        particle_radius: m.
        support_radius: m, four particle radii.
        dt: Time between two frames, s.
        density0: Rest density, kg/m³.
        viscosity: Viscosity coefficient of the solver.
    """

    scene: str
    solver: str
    solver_version: str
    solver_parameters: dict[str, Any]
    domain_lower: tuple[float, float, float]
    domain_upper: tuple[float, float, float]
    gravity: tuple[float, float, float]
    particle_radius: float
    support_radius: float
    dt: float
    density0: float
    viscosity: float

    def write(self, file: h5py.File) -> None:
        """Write the attributes to an open file."""
        file.attrs["schema_version"] = SCHEMA_VERSION
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "solver_parameters":
                value = json.dumps(value)
            elif field.name in VECTORS:
                value = np.array(value, dtype=np.float64)
            file.attrs[field.name] = value

    @classmethod
    def read(cls, file: h5py.File) -> Self:
        """Read the attributes of an open, valid file."""
        values: dict[str, Any] = {}
        for field in fields(cls):
            value = file.attrs[field.name]
            if field.name == "solver_parameters":
                value = json.loads(value)
            elif field.name in VECTORS:
                value = tuple(float(component) for component in value)
            elif field.name in _FLOATS:
                value = float(value)
            values[field.name] = value
        return cls(**values)


def simulations(file: h5py.File) -> list[str]:
    """Return the names of the simulations in a file, sorted."""
    return sorted(name for name in file if isinstance(file[name], h5py.Group))


def create_frames(group: h5py.Group, particles: int) -> tuple[h5py.Dataset, h5py.Dataset]:
    """Create the position and velocity data sets of a group, with no frame yet.

    Args:
        group: Group of one simulation.
        particles: Number of fluid particles.

    Returns:
        Position and velocity, each (0, particles, 3), to be resized for each frame.
    """
    position, velocity = (
        group.create_dataset(
            name,
            shape=(0, particles, 3),
            maxshape=(None, particles, 3),
            chunks=(1, max(particles, 1), 3),
            dtype=np.float32,
            **COMPRESSION,
        )
        for name in ("position", "velocity")
    )
    return position, velocity


def open_valid(path: Path) -> h5py.File:
    """Open a file for reading after `validate`.

    Raises:
        UserError: as `validate`.
    """
    validate(path)
    return h5py.File(path, "r")


def validate(path: Path) -> None:
    """Check that a file has the format of this module, without reading particle data.

    Raises:
        UserError: it has not; the message names the file, the group, the data set and the
            expected value.
    """
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; make it with `fluidsnet generate`.")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise UserError(
            f"{path}: not a whole HDF5 file (damaged, truncated, or of another format): {error}."
        ) from error
    with file:
        try:
            _validate_header(path, file)
            names = simulations(file)
            if not names:
                raise UserError(f"{path}: no simulation in it; expected groups such as /00000.")
            for name in names:
                _validate_simulation(path, file[name])
        except DAMAGE as error:
            raise UserError(f"{path}: the file is damaged: {error}.") from error


def _validate_header(path: Path, file: h5py.File) -> None:
    version = file.attrs.get("schema_version")
    if version is None:
        raise UserError(
            f"{path}: the attribute schema_version is missing; it is not a FluidsNet data file."
        )
    if version != SCHEMA_VERSION:
        raise UserError(f"{path}: schema_version is {version}; FluidsNet reads {SCHEMA_VERSION}.")
    for field in fields(Header):
        if field.name not in file.attrs:
            raise UserError(f"{path}: the attribute {field.name} is missing.")
    for names, shape, expected in ((VECTORS, (3,), "three numbers"), (_FLOATS, (), "one number")):
        for name in names:
            value = np.asarray(file.attrs[name])
            if not np.issubdtype(value.dtype, np.number) or value.shape != shape:
                raise UserError(f"{path}: the attribute {name} must be {expected}.")
    try:
        json.loads(file.attrs["solver_parameters"])
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: the attribute solver_parameters must be JSON.") from error
    if not np.all(np.asarray(file.attrs["domain_upper"]) > file.attrs["domain_lower"]):
        raise UserError(f"{path}: domain_upper must be above domain_lower on every axis.")
    for name in ("particle_radius", "support_radius", "dt"):
        if not float(file.attrs[name]) > 0:
            raise UserError(f"{path}: the attribute {name} must be above zero.")


def _validate_simulation(path: Path, group: h5py.Group) -> None:
    where = f"{path}: {group.name}"
    position = _dataset(where, group, "position")
    if position.ndim != 3 or position.shape[2] != 3:
        raise UserError(f"{where}/position has shape {position.shape}; expected (T, N, 3).")
    frames, particles = position.shape[:2]
    if frames == 0 or particles == 0:
        raise UserError(
            f"{where}/position has shape {position.shape}; "
            "expected at least one frame and one particle."
        )
    _expect_shape(where, group, "velocity", (frames, particles, 3))
    _expect_shape(where, group, "time", (frames,))
    _expect_shape(where, group, "solver_seconds", (frames,))
    solid = _dataset(where, group, "solid_position")
    if solid.ndim == 3:
        _expect_shape(where, group, "solid_position", (frames, solid.shape[1], 3))
        _expect_shape(where, group, "solid_velocity", (frames, solid.shape[1], 3))
    elif solid.ndim != 2 or solid.shape[1] != 3:
        raise UserError(
            f"{where}/solid_position has shape {solid.shape}; expected (M, 3) or (T, M, 3)."
        )


def _dataset(where: str, group: h5py.Group, name: str) -> h5py.Dataset:
    dataset = group.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise UserError(f"{where}: the data set {name} is missing.")
    if dataset.dtype.kind != "f":
        raise UserError(f"{where}/{name} holds {dataset.dtype}; expected floating-point numbers.")
    return dataset


def _expect_shape(where: str, group: h5py.Group, name: str, shape: tuple[int, ...]) -> None:
    found = _dataset(where, group, name).shape
    if found != shape:
        raise UserError(f"{where}/{name} has shape {found}; expected {shape}.")
