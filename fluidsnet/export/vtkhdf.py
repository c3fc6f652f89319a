"""Temporal VTKHDF file of a rollout, for ParaView and VTK.

Layout, for T steps of N particles::

    /VTKHDF                            attributes: Version, Type = PolyData, and those given
    /VTKHDF/Points                     (T·N, 3) float32, m       one step per chunk
    /VTKHDF/PointData/<name>           (T·N,) or (T·N, 3)        one step per chunk
    /VTKHDF/FieldData/<name>           (T,) float64              one number per step
    /VTKHDF/Vertices/...               N cells of one point, stored once
    /VTKHDF/Lines, Polygons, Strips    empty; the format requires them
    /VTKHDF/Steps                      attribute: NSteps = T
    /VTKHDF/Steps/Values               (T,) float64, s
    /VTKHDF/Steps/...Offsets           (T,) or (T, 4) int64: where a step starts in the above
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self, TypeAlias

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fluidsnet.disk_space import check_space, not_written
from fluidsnet.errors import NotWritten, UserError

Array: TypeAlias = NDArray[Any]

# Of HDF5.
_HDF5_ERRORS = (OSError, RuntimeError)
# Files that HDF5 could not write: it crashes where it closes one, as when nothing refers to it.
_GIVEN_UP: list[h5py.File] = []

_COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}

#: Topologies, in the order of the columns of CellOffsets and ConnectivityIdOffsets.
_TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")


class TrajectoryFile:
    """Writer of a rollout, step by step; memory does not grow with the number of steps.

    The file is written as ``<path>.tmp`` and renamed to ``<path>``, over an older one, when the
    ``with`` block ends. It is valid after every `append`, and renamed even where an exception
    ends the block: a rollout stopped at step 900 is a file of 900 steps. Without a step the
    temporary file is removed and ``<path>`` stays as it was. A killed process leaves
    ``<path>.tmp`` with the steps appended so far. On a full disk a step is refused before HDF5
    begins to write it; where HDF5 fails itself (`NotWritten`), ``<path>.tmp`` stays.

    Example::

        with TrajectoryFile("rollout.vtkhdf", particles=4732) as file:
            file.append(0.02, position, {"velocity": velocity}, {"kinetic_energy": 8.1})

    Args:
        path: Path of the file; it must end in ``.vtkhdf``, which ParaView requires.
        particles: N, the same in every step.
        attributes: Numbers of the whole file, such as ``particle_radius`` (m), by name.
    """

    def __init__(
        self, path: str | Path, particles: int, attributes: Mapping[str, ArrayLike] | None = None
    ) -> None:
        self.path = Path(path)
        if self.path.suffix != ".vtkhdf":
            raise UserError(f"{path}: the name of a trajectory file must end in .vtkhdf.")
        if particles < 1:
            raise ValueError(f"particles must be at least 1, not {particles}")
        self.particles, self._attributes = particles, attributes or {}
        self._temporary = self.path.with_name(self.path.name + ".tmp")
        self._file: h5py.File | None = None
        self._steps = 0
        self._last_time = -np.inf
        self._first: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # Vertices and offsets are stored once, 8 bytes each.
            check_space(self.path, 16 * self.particles)
            self._file = h5py.File(self._temporary, "w")
        except OSError as error:
            raise UserError(f"{self.path}: cannot be written: {error}.") from error
        try:
            root = self._file.create_group("VTKHDF")
            root.attrs.update(self._attributes)
            _write_static(root, self.particles)
        except _HDF5_ERRORS as error:
            file, self._file = self._file, None
            raise self._given_up(file, error) from error
        return self

    def __exit__(self, *exception: object) -> None:
        if self._file is None:
            return
        file, self._file = self._file, None
        try:
            for name, (shape, _) in self._first.items():
                # An interrupted append may have left rows after the last complete step.
                file["VTKHDF"][name].resize(self._steps * shape[0], axis=0)
            file["VTKHDF/Steps"].attrs.modify("NSteps", np.int64(self._steps))
            file.close()
        except _HDF5_ERRORS as error:
            raise self._given_up(file, error) from error
        if self._steps:
            os.replace(self._temporary, self.path)
        else:
            self._temporary.unlink()

    def append(
        self,
        time: float,
        position: Array,
        point_data: Mapping[str, Array] | None = None,
        field_data: Mapping[str, float] | None = None,
    ) -> None:
        """Append one step; nothing is written if an argument is wrong.

        Args:
            time: s, later than that of the last step.
            position: (N, 3), m, stored as float32; float64 as it is.
            point_data: Name -> (N,) or (N, 3) real numbers. Names, shapes and types must be
                those of the first step.
            field_data: Name -> one number for the step. Names must be those of the first step.

        Raises:
            ValueError: names, shapes or types differ from the first step, or time is not later.
            UserError: the disk is full; the steps before are kept.
            NotWritten: HDF5 could not write.
        """
        if self._file is None:
            raise RuntimeError("append must be called in the `with` block of the TrajectoryFile")
        if not (np.isfinite(time) and time > self._last_time):
            raise ValueError(f"time must be later than {self._last_time} s, not {time} s")
        step = self._rows(time, position, point_data or {}, field_data or {})
        self._check(step)
        kept = f"; its {self._steps} steps up to {self._last_time:g} s are kept"
        size = sum(rows.nbytes for rows in step.values())
        check_space(self.path, size, kept if self._steps else "")
        try:
            self._write(self._file, step)
        except _HDF5_ERRORS as error:
            file, self._file = self._file, None
            raise self._given_up(file, error) from error
        self._steps, self._last_time = self._steps + 1, time

    def _write(self, file: h5py.File, step: dict[str, Array]) -> None:
        root = file["VTKHDF"]
        for name, rows in step.items():
            if name not in self._first:
                tail = rows.shape[1:]
                # A chunk is one step of the particles, or many steps of a single row.
                chunks = (len(rows) if len(rows) > 1 else 1024, *tail)
                shapes = {"shape": (0, *tail), "maxshape": (None, *tail), "chunks": chunks}
                root.create_dataset(name, dtype=rows.dtype, **shapes, **_COMPRESSION)
                self._first[name] = (rows.shape, rows.dtype)
            start = self._steps * len(rows)
            root[name].resize(start + len(rows), axis=0)
            root[name][start:] = rows
        root["Steps"].attrs.modify("NSteps", np.int64(self._steps + 1))
        file.flush()

    def _given_up(self, file: h5py.File, error: OSError | RuntimeError) -> NotWritten:
        """Return what went wrong, and never touch the file again."""
        _GIVEN_UP.append(file)
        said = " ".join(str(error).split()[:20])
        return not_written(error, self.path) or NotWritten(
            f"{self.path} cannot be written: {said}."
        )

    def _rows(
        self, time: float, position: Array, points: Mapping[str, Array], field: Mapping[str, float]
    ) -> dict[str, Array]:
        """Return the rows of a step, one or N, by name of the data set under /VTKHDF."""
        first = self._steps * self.particles
        rows: dict[str, Array] = {
            "Points": np.asarray(position, dtype=_place_type(position)),
            "Steps/Values": np.array([time], dtype=np.float64),
            "Steps/PointOffsets": np.array([first], dtype=np.int64),
            "Steps/NumberOfParts": np.array([1], dtype=np.int64),
            # 0 in every step: all steps share one set of vertices.
            "Steps/PartOffsets": np.array([0], dtype=np.int64),
            "Steps/CellOffsets": np.zeros((1, len(_TOPOLOGIES)), dtype=np.int64),
            "Steps/ConnectivityIdOffsets": np.zeros((1, len(_TOPOLOGIES)), dtype=np.int64),
        }
        for name, values in points.items():
            rows[f"PointData/{name}"] = np.asarray(values)
            rows[f"Steps/PointDataOffsets/{name}"] = np.array([first], dtype=np.int64)
        for name, value in field.items():
            rows[f"FieldData/{name}"] = np.array([float(value)])
            rows[f"Steps/FieldDataOffsets/{name}"] = np.array([self._steps], dtype=np.int64)
            rows[f"Steps/FieldDataSizes/{name}"] = np.array([[1, 1]], dtype=np.int64)
        return rows

    def _check(self, step: dict[str, Array]) -> None:
        odd = sorted(set(step) ^ set(self._first)) if self._steps else []
        if names := ", ".join(name for name in odd if not name.startswith("Steps")):
            raise ValueError(f"a step must have the names of the first; missing or new: {names}")
        n = self.particles
        allowed: dict[str, set[tuple[int, ...]]]
        allowed = {"Points": {(n, 3)}, "PointData": {(n,), (n, 3)}, "FieldData": {(1,)}}
        for name, rows in step.items():
            kind, _, label = name.partition("/")
            if kind == "Steps":
                continue
            if "/" in label or (kind != "Points" and label in ("", ".")) or label == "time":
                raise ValueError(f"data cannot be named {label!r}: empty, reserved, or with a '/'")
            # VTK has no half precision and no booleans.
            if rows.dtype.kind not in "fiu" or rows.dtype == np.float16:
                raise ValueError(f"{name} holds {rows.dtype}, which VTK does not support")
            shape, dtype = self._first.get(name, (rows.shape, rows.dtype))
            if rows.shape not in allowed[kind] or rows.shape != shape:
                wanted = {shape} if self._steps else allowed[kind]
                raise ValueError(f"{name} has shape {rows.shape}; expected one of {wanted}")
            if not np.can_cast(rows.dtype, dtype, "same_kind"):
                raise ValueError(f"{name} holds {rows.dtype}; in the first step it was {dtype}")


def read_field_data(path: str | Path) -> dict[str, NDArray[np.float64]]:
    """Read the field data of every step.

    Returns:
        Name -> (T,); the key ``time`` holds the time of each step, s.

    Raises:
        UserError: the file is not a complete trajectory file.
    """
    with _opened(path) as root:
        steps = int(root["Steps"].attrs["NSteps"])
        columns = {"time": root["Steps/Values"], **root.get("FieldData", {})}
        return {name: np.asarray(values[:steps], float) for name, values in columns.items()}


def read_attributes(path: str | Path) -> dict[str, Any]:
    """Read the attributes of the whole file, by name.

    Raises:
        UserError: the file is not a complete trajectory file.
    """
    with _opened(path) as root:
        return {
            name: value for name, value in root.attrs.items() if name not in ("Type", "Version")
        }


def _place_type(position: Array) -> type[np.float32 | np.float64]:
    return np.float64 if position.dtype == np.float64 else np.float32


def read_frame(path: str | Path, step: int) -> tuple[Array, dict[str, Array]]:
    """Read one step.

    Args:
        path: Path of the file.
        step: Index of the step; negative counts from the last, as in a list.

    Returns:
        Position (N, 3), m, and name -> (N,) or (N, 3).

    Raises:
        UserError: the file is not a complete trajectory file, or has no such step.
    """
    with _opened(path) as root:
        steps = int(root["Steps"].attrs["NSteps"])
        if not -steps <= step < steps:
            raise UserError(f"{path}: there is no step {step}; the file has {steps} steps.")
        (particles,) = root["NumberOfPoints"][...]
        first = int(root["Steps/PointOffsets"][step % steps])
        rows = slice(first, first + int(particles))
        position = np.asarray(root["Points"][rows])
        point_data = root.get("PointData", {}).items()
        return position, {name: np.asarray(values[rows]) for name, values in point_data}


@contextmanager
def _opened(path: str | Path) -> Iterator[h5py.Group]:
    """Open the group /VTKHDF of a file; errors while reading become a UserError."""
    if not Path(path).is_file():
        raise UserError(f"{path}: there is no such file.")
    try:
        with h5py.File(path, "r") as file:
            if "VTKHDF/Steps" not in file:
                raise UserError(f"{path}: not a trajectory file: it has no group /VTKHDF/Steps.")
            yield file["VTKHDF"]
    except (OSError, KeyError, IndexError, TypeError, ValueError) as error:
        problem = "not a whole trajectory file (damaged, truncated, or of another format)"
        raise UserError(f"{path}: {problem}: {error}.") from error


def _write_static(root: h5py.Group, particles: int) -> None:
    """Write the data sets that are the same in every step."""
    root.attrs["Version"] = np.array([2, 3], dtype=np.int64)
    # VTK reads strings of fixed length only.
    root.attrs.create("Type", b"PolyData", dtype=h5py.string_dtype("ascii", len("PolyData")))
    root["NumberOfPoints"] = np.array([particles], dtype=np.int64)
    for topology in _TOPOLOGIES:
        cells = particles if topology == "Vertices" else 0
        group = root.create_group(topology)
        group["NumberOfCells"] = np.array([cells], dtype=np.int64)
        group["NumberOfConnectivityIds"] = np.array([cells], dtype=np.int64)
        group["Connectivity"] = np.arange(cells, dtype=np.int64)
        group["Offsets"] = np.arange(cells + 1, dtype=np.int64)
    root.create_group("Steps").attrs["NSteps"] = np.int64(0)
