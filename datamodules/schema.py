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
    """Attributes of a file."""

    scene: str  # name of the scene kind
    solver: str
    solver_version: str
    solver_parameters: dict[str, Any]  # under the solver's names
    domain_lower: tuple[float, float, float]  # corner of the box, m
    domain_upper: tuple[float, float, float]
    gravity: tuple[float, float, float]  # m/s²
    particle_radius: float  # m
    support_radius: float  # m, four particle radii
    dt: float  # time between two frames, s
    density0: float  # rest density, kg/m³
    viscosity: float  # coefficient of the solver

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
            elif field.name in (*VECTORS, *_FLOATS):
                value = np.asarray(value, dtype=np.float64).tolist()
            values[field.name] = tuple(value) if field.name in VECTORS else value
        return cls(**values)


def simulations(file: h5py.File) -> list[str]:
    """Return the names of the simulations in a file, sorted."""
    return sorted(name for name in file if isinstance(file[name], h5py.Group))


def create_frames(group: h5py.Group, particles: int) -> tuple[h5py.Dataset, h5py.Dataset]:
    """Create position and velocity in a group, each (0, particles, 3), to be resized."""
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
    """Open a file for reading and check its format, without reading particle data.

    Raises:
        UserError: it has another format; the message names the file, the group, the data set
            and the expected value.
    """
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; make it with `fluidsnet generate`.")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise UserError(
            f"{path}: not a whole HDF5 file (damaged, truncated, or of another format): {error}."
        ) from error
    try:
        _check_header(file)
        if not simulations(file):
            raise UserError("no simulation in it; expected groups such as /00000.")
        for name in simulations(file):
            _check_simulation(file[name])
    except (UserError, *DAMAGE) as error:
        file.close()
        text = error if isinstance(error, UserError) else f"the file is damaged: {error}."
        raise UserError(f"{path}: {text}") from error
    return file


def validate(path: Path) -> None:
    """Raise a `UserError` if a file has another format, as `open_valid` does."""
    open_valid(path).close()


def _check_header(file: h5py.File) -> None:
    version = file.attrs.get("schema_version")
    if version is None:
        raise UserError("the attribute schema_version is missing; it is not a FluidsNet data file.")
    if version != SCHEMA_VERSION:
        raise UserError(f"schema_version is {version}; FluidsNet reads {SCHEMA_VERSION}.")
    for field in fields(Header):
        if field.name not in file.attrs:
            raise UserError(f"the attribute {field.name} is missing.")
    for names, shape, expected in ((VECTORS, (3,), "three numbers"), (_FLOATS, (), "one number")):
        for name in names:
            value = np.asarray(file.attrs[name])
            if not np.issubdtype(value.dtype, np.number) or value.shape != shape:
                raise UserError(f"the attribute {name} must be {expected}.")
    try:
        header = Header.read(file)
    except (TypeError, ValueError) as error:
        raise UserError("the attribute solver_parameters must be JSON.") from error
    if not np.greater(header.domain_upper, header.domain_lower).all():
        raise UserError("domain_upper must be above domain_lower on every axis.")
    for name in ("particle_radius", "support_radius", "dt"):
        if not getattr(header, name) > 0:
            raise UserError(f"the attribute {name} must be above zero.")


def _check_simulation(group: h5py.Group) -> None:
    def shape(name: str, *expected: int) -> tuple[int, ...]:
        dataset, where = group.get(name), f"{group.name}/{name}"
        if not isinstance(dataset, h5py.Dataset):
            raise UserError(f"{group.name}: the data set {name} is missing.")
        if dataset.dtype.kind != "f":
            raise UserError(f"{where} holds {dataset.dtype}; expected floating-point numbers.")
        if expected and dataset.shape != expected:
            raise UserError(f"{where} has shape {dataset.shape}; expected {expected}.")
        found: tuple[int, ...] = dataset.shape
        return found

    position = shape("position")
    if len(position) != 3 or position[2] != 3 or 0 in position:
        raise UserError(
            f"{group.name}/position has shape {position}; expected (T, N, 3), with at least one "
            "frame and one particle."
        )
    shape("velocity", *position)
    shape("time", position[0])
    shape("solver_seconds", position[0])
    solid = shape("solid_position")
    if len(solid) == 3:
        shape("solid_position", position[0], solid[1], 3)
        shape("solid_velocity", position[0], solid[1], 3)
    elif len(solid) != 2 or solid[1] != 3:
        raise UserError(
            f"{group.name}/solid_position has shape {solid}; expected (M, 3) or (T, M, 3)."
        )
