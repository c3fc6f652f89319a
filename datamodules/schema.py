"""HDF5 file format: names, shapes, units and validation.

One file holds one split of a data set, one group of it one simulation::

    /                attributes: schema_version, scene, solver, ...  (Header)
    /00000/          attributes: domain_lower, gravity, ...  (SceneAttributes); those that a
                     group does not have are read from the file
    /00000/position  (T, N, 3) float32, m        one frame a chunk
    /00000/velocity  (T, N, 3) float32, m/s      one frame a chunk
    /00000/time      (T,) float64, s
    /00000/solver_seconds  (T,) float64, s       the solver's wall time for a frame's steps
    /00000/solid_position  (M, 3) float32, m     (T, M, 3) where solids move
    /00000/solid_velocity  (T, M, 3) float32, m/s  only where solids move
    /00000/          attributes, none of them needed: seed, scene_parameters (JSON), threads

Row i is the same particle in every frame. Other groups and attributes are ignored. Schema 1,
whose scene attributes are the file's alone, is read as it is.
"""

from __future__ import annotations

import json
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np

from datamodules.guard import guarded
from datamodules.storage import check_links, check_stored, open_file
from fluidsnet.checksums import verify
from fluidsnet.errors import UserError
from fluidsnet.printable import printable

#: Version that is written.
SCHEMA_VERSION = 2
#: Versions that are read.
READ_VERSIONS = (1, 2)

#: Splits of a data set; each has a file.
SPLITS = ("train", "val", "test")

#: Filters that every h5py build reads. Gzip at level 1 keeps 76 % of the bytes of a frame of a
#: dam break and writes 4,900 particles in 1.8 ms; level 9 takes 3.0 ms for 75 %, lzf 0.7 ms for
#: 81 % (median of 13 frames, three times, each written to memory on one core).
COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}

#: Most characters of the name of a simulation, by which files are named.
LONGEST_NAME = 100

#: Exceptions that h5py raises for a damaged file.
DAMAGE = (OSError, KeyError, RuntimeError, TypeError, ValueError)


@dataclass(frozen=True)
class SceneAttributes:
    """Scene of one simulation: attributes of its group, or of the file for all of its groups."""

    domain_lower: tuple[float, float, float]  # corner of the box, m
    domain_upper: tuple[float, float, float]
    gravity: tuple[float, float, float]  # m/s²
    density0: float  # rest density, kg/m³
    viscosity: float  # coefficient of the solver
    surface_tension: float = 0.0  # coefficient of the solver
    periodic: tuple[bool, bool, bool] = (False, False, False)  # axes that wrap around
    dimension: int = 3  # in 2 the third coordinate is constant and ignored

    def write(self, group: h5py.Group) -> None:
        """Write the attributes to a group of an open file."""
        for field in fields(self):
            group.attrs[field.name] = np.array(getattr(self, field.name), _TYPES[field.name][0])

    @classmethod
    def read(cls, group: h5py.Group) -> Self:
        """Read the attributes of a simulation in an open file.

        Raises:
            UserError: an attribute is missing, or its value is not possible.
        """
        values: dict[str, Any] = {}
        for field in fields(cls):
            name, (dtype, shape) = field.name, _TYPES[field.name]
            owner = group if name in group.attrs else group.file
            if name not in owner.attrs:
                if field.default is MISSING:
                    raise UserError(
                        f"{group.name}: the attribute {name} is missing; expected on the "
                        "simulation's group or on the file."
                    )
                continue
            value = np.asarray(owner.attrs[name])
            if value.dtype.kind not in "biuf" or value.shape != shape:
                expected = "three" if shape else "one"
                kind = "booleans" if dtype is np.bool_ else f"number{'s' if shape else ''}"
                raise UserError(f"{_where(owner, name)} must be {expected} {kind}.")
            if not np.isfinite(value).all():
                raise UserError(f"{_where(owner, name)} is {value.tolist()}; it must be finite.")
            if np.abs(value).max() > GREATEST:
                raise UserError(
                    f"{_where(owner, name)} is {value.tolist()}; single precision ends at 1e38."
                )
            plain = value.astype(dtype).tolist()
            values[name] = tuple(plain) if shape else plain
        scene = cls(**values)
        if not np.greater(scene.domain_upper, scene.domain_lower).all():
            raise UserError(f"{group.name}: domain_upper must be above domain_lower on every axis.")
        for name, least in (("density0", 1e-30), ("viscosity", 0.0), ("surface_tension", 0.0)):
            if getattr(scene, name) < least:
                raise UserError(
                    f"{group.name}: {name} is {getattr(scene, name)}; it must be "
                    f"{'at least' if least == 0 else 'above'} zero."
                )
        if scene.dimension not in (2, 3):
            raise UserError(f"{group.name}: dimension is {scene.dimension}; it must be 2 or 3.")
        return scene


_VECTOR, _NUMBER = (np.float64, (3,)), (np.float64, ())
#: Type and shape of each scene attribute in a file.
_TYPES: dict[str, tuple[Any, tuple[int, ...]]] = {
    "domain_lower": _VECTOR,
    "domain_upper": _VECTOR,
    "gravity": _VECTOR,
    "density0": _NUMBER,
    "viscosity": _NUMBER,
    "surface_tension": _NUMBER,
    "periodic": (np.bool_, (3,)),
    "dimension": (np.int64, ()),
}


def _where(owner: h5py.Group, name: str) -> str:
    return f"the attribute {name}" if owner.name == "/" else f"{owner.name}: the attribute {name}"


@dataclass(frozen=True)
class Header:
    """Attributes of a file that hold for all of its simulations."""

    scene: str  # name of the scene kind
    solver: str
    solver_version: str
    solver_parameters: dict[str, Any]  # under the solver's names
    particle_radius: float  # m
    support_radius: float  # m, four particle radii
    dt: float  # time between two frames, s

    def write(self, file: h5py.File) -> None:
        """Write the attributes to an open file."""
        file.attrs["schema_version"] = SCHEMA_VERSION
        for field in fields(self):
            value = getattr(self, field.name)
            file.attrs[field.name] = (
                json.dumps(value) if field.name == "solver_parameters" else value
            )

    @classmethod
    def read(cls, file: h5py.File) -> Self:
        """Read the attributes of an open, valid file."""
        values: dict[str, Any] = {field.name: file.attrs[field.name] for field in fields(cls)}
        values["solver_parameters"] = json.loads(values["solver_parameters"])
        texts = {name: printable(str(values[name])) for name in TEXTS}
        return cls(**values | texts | {name: float(values[name]) for name in LENGTHS})


#: Greatest value that is taken from a file; float32 ends at 1e38.
GREATEST = 1e30
# Least length and time; volumes of smaller particles are zero in float32.
_LEAST = 1e-12
#: Attributes of the file that are one positive number.
LENGTHS = ("particle_radius", "support_radius", "dt")
#: Attributes of the file that are text.
TEXTS = ("scene", "solver", "solver_version")


def simulations(file: h5py.File) -> list[str]:
    """Return the names of the simulations in a file, sorted.

    These are the groups whose name is a number or that have a data set `position`.
    """
    groups = (name for name in file if isinstance(file[name], h5py.Group))
    return sorted(
        name
        for name in groups
        if name.isdecimal() or isinstance(file[name].get("position"), h5py.Dataset)
    )


def create_frames(
    group: h5py.Group, particles: int, names: tuple[str, str] = ("position", "velocity")
) -> tuple[h5py.Dataset, h5py.Dataset]:
    """Create position and velocity in a group, each (0, particles, 3), to be resized.

    Args:
        group: Group of a simulation.
        particles: Number of particles.
        names: Names of the two data sets, such as those of solids that move.
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
        for name in names
    )
    return position, velocity


def open_valid(path: Path) -> h5py.File:
    """Open a file for reading and check its format, without reading particle data.

    Raises:
        UserError: it has another format, or is not that of its checksum; the message names the
            file, the group, the data set and the expected value.
    """
    guarded(path, lambda: _open_checked(path))
    verify(path)
    return _open_checked(path)


def _open_checked(path: Path) -> h5py.File:
    file = open_file(path)
    try:
        _check_header(file)
        check_links(file)
        if not simulations(file):
            raise UserError("no simulation in it; expected groups such as /00000.")
        for name in simulations(file):
            if not name.isprintable() or len(name) > LONGEST_NAME:
                raise UserError(
                    f"the group {name[:LONGEST_NAME]!r} must have a name of at most "
                    f"{LONGEST_NAME} printable characters."
                )
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
    if np.ndim(version) or version not in READ_VERSIONS:
        versions = " and ".join(map(str, READ_VERSIONS))
        raise UserError(f"schema_version is {version}; FluidsNet reads {versions}.")
    for field in fields(Header):
        if field.name not in file.attrs:
            raise UserError(f"the attribute {field.name} is missing.")
    for name in LENGTHS:
        value = np.asarray(file.attrs[name])
        if value.dtype.kind not in "iuf" or value.shape != ():
            raise UserError(f"the attribute {name} must be one number.")
        if not (np.isfinite(value) and value > 0):
            raise UserError(f"the attribute {name} is {value}; it must be finite and above zero.")
        if not _LEAST <= value <= 1 / _LEAST:
            raise UserError(
                f"the attribute {name} is {value}; it must lie between {_LEAST:g} and "
                f"{1 / _LEAST:g}: other units would do."
            )
    radius, support = (float(file.attrs[name]) for name in LENGTHS[:2])
    if support <= radius:
        raise UserError(
            f"support_radius is {support:g}, and particle_radius {radius:g}; particles would have "
            "no neighbors."
        )
    try:
        Header.read(file)
    except (TypeError, ValueError) as error:
        raise UserError("the attribute solver_parameters must be JSON.") from error


def _check_simulation(group: h5py.Group) -> None:
    check_links(group)
    SceneAttributes.read(group)

    def shape(name: str, *expected: int) -> tuple[int, ...]:
        dataset, where = group.get(name), f"{group.name}/{name}"
        if not isinstance(dataset, h5py.Dataset):
            raise UserError(f"{group.name}: the data set {name} is missing.")
        if dataset.dtype.kind != "f":
            raise UserError(f"{where} holds {dataset.dtype}; expected floating-point numbers.")
        if expected and dataset.shape != expected:
            raise UserError(f"{where} has shape {dataset.shape}; expected {expected}.")
        check_stored(dataset)
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
