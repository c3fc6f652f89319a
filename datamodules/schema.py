"""The HDF5 files: names, shapes, units, and what makes a file valid.

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

#: A data set has a file of each.
SPLITS = ("train", "val", "test")

#: Every h5py reads these. A frame of a dam break of 4,900 particles takes 1.8 ms to write and
#: keeps 76 % of its bytes; at level 4 1.9 ms and 75 %, at 9 3.0 ms and 75 %, with lzf 0.7 ms
#: and 81 % (median of 13 frames 50 ms apart, three times, each written to memory on one core).
COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}

#: What h5py raises for a file that is damaged.
DAMAGE = (OSError, KeyError, RuntimeError)

_VECTORS = ("domain_lower", "domain_upper", "gravity")
_FLOATS = ("particle_radius", "support_radius", "dt", "density0", "viscosity")


@dataclass(frozen=True)
class Header:
    """The attributes of a file.

    Attributes:
        scene: name of the scene kind.
        solver: name of the pressure solver.
        solver_version: of the program that ran it.
        solver_parameters: what the solver was told, as it names it.
        domain_lower, domain_upper: corners of the box, m.
        gravity: m/s².
        particle_radius: m.
        support_radius: m, four particle radii.
        dt: time between two frames, s.
        density0: rest density, kg/m³.
        viscosity: as the solver's.
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
        """Stores the attributes in an open file."""
        file.attrs["schema_version"] = SCHEMA_VERSION
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "solver_parameters":
                value = json.dumps(value)
            elif field.name in _VECTORS:
                value = np.array(value, dtype=np.float64)
            file.attrs[field.name] = value

    @classmethod
    def read(cls, file: h5py.File) -> Self:
        """Reads the attributes of an open, valid file."""
        values: dict[str, Any] = {}
        for field in fields(cls):
            value = file.attrs[field.name]
            if field.name == "solver_parameters":
                value = json.loads(value)
            elif field.name in _VECTORS:
                value = tuple(float(component) for component in value)
            elif field.name in _FLOATS:
                value = float(value)
            values[field.name] = value
        return cls(**values)


def simulations(file: h5py.File) -> list[str]:
    """Names of the simulations in a file, in order."""
    return sorted(name for name in file if isinstance(file[name], h5py.Group))


def create_frames(group: h5py.Group, particles: int) -> tuple[h5py.Dataset, h5py.Dataset]:
    """Makes the position and velocity data sets of a group, with no frame yet.

    Args:
        group: of one simulation.
        particles: number of fluid particles.

    Returns:
        position and velocity, each (0, particles, 3), to be resized as frames come.
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
    """Opens a file for reading after `validate`.

    Raises:
        UserError: as `validate`.
    """
    validate(path)
    return h5py.File(path, "r")


def validate(path: Path) -> None:
    """Checks that a file is what this module describes; reads no particle data.

    Raises:
        UserError: names the file, the group and the data set at fault, and what was expected.
    """
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; make it with `fluidsnet generate`.")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise UserError(
            f"{path}: not a whole HDF5 file (damaged, cut short, or of another kind): {error}."
        ) from error
    with file:
        try:
            _validate_header(path, file)
            names = simulations(file)
            if not names:
                raise UserError(f"{path}: holds no simulation; expected groups such as /00000.")
            for name in names:
                _validate_simulation(path, file[name])
        except DAMAGE as error:
            raise UserError(f"{path}: the file is damaged: {error}.") from error


def _validate_header(path: Path, file: h5py.File) -> None:
    version = file.attrs.get("schema_version")
    if version is None:
        raise UserError(
            f"{path}: has no attribute schema_version; it is not a FluidsNet data file."
        )
    if version != SCHEMA_VERSION:
        raise UserError(
            f"{path}: schema_version is {version}; this program reads {SCHEMA_VERSION}."
        )
    for field in fields(Header):
        if field.name not in file.attrs:
            raise UserError(f"{path}: the attribute {field.name} is missing.")
    for name in (*_VECTORS, *_FLOATS):
        if not np.issubdtype(np.asarray(file.attrs[name]).dtype, np.number):
            raise UserError(f"{path}: the attribute {name} must hold numbers.")
    for name in _FLOATS:
        if np.shape(file.attrs[name]) != ():
            raise UserError(f"{path}: the attribute {name} must be one number.")
    try:
        json.loads(file.attrs["solver_parameters"])
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: the attribute solver_parameters must be JSON.") from error
    for name in _VECTORS:
        if np.shape(file.attrs[name]) != (3,):
            raise UserError(f"{path}: the attribute {name} must be three numbers.")
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
