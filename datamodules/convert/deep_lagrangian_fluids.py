"""DeepLagrangianFluids: the compressed records that CConv is trained on.

Ummenhofer et al. 2020, https://github.com/isl-org/DeepLagrangianFluids. A simulation is several
files, ``sim_0001_00.msgpack.zst``, ``sim_0001_01.msgpack.zst`` and so on, with a list of frames
in each: ``pos``, ``vel`` (N, 3), ``m``, ``viscosity`` (N,), ``frame_id``; the first frame of a
file also has the samples of the walls, ``box`` and ``box_normals`` (M, 3).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from datamodules.convert.options import Options
from datamodules.convert.simulation import Array, Frame, Simulation
from datamodules.convert.splits import assign
from datamodules.schema import Header, SceneAttributes
from fluidsnet.errors import UserError

_SUFFIX = ".msgpack.zst"
_OPTIONS = frozenset(
    {"dt", "particle_radius", "gravity", "domain", "viscosity", "density0", "split"}
)

#: Constants of the scripts that made the data (``datasets/create_physics_scenes.py``).
_CONSTANTS = {"dt": 0.02, "particle_radius": 0.025, "gravity": [0.0, -9.81, 0.0]}

Record = dict[str, Any]


def is_deep_lagrangian_fluids(folder: Path) -> bool:
    """Return whether a folder has this format."""
    return any(folder.rglob(f"*{_SUFFIX}"))


@final
class DeepLagrangianFluids:
    """Data set of DeepLagrangianFluids.

    Args:
        folder: Its folder, with or without the folders ``train`` and ``valid``.
        options: Options of the conversion.

    Raises:
        UserError: There are no such files, or a package is missing.
    """

    def __init__(self, folder: Path, options: Options) -> None:
        options.refuse_others(_OPTIONS, "DeepLagrangianFluids data")
        self._options = options
        self._files: dict[str, list[Path]] = {}
        for path in sorted(folder.rglob(f"*{_SUFFIX}")):
            stem = str(path.relative_to(folder).as_posix())[: -len(_SUFFIX)]
            self._files.setdefault(re.sub(r"_\d{2,3}$", "", stem), []).append(path)
        if not self._files:
            raise UserError(f"{folder} has no file *{_SUFFIX}.")
        for paths in self._files.values():
            paths.sort(key=lambda path: int(re.findall(r"\d+", path.name)[-1]))
        self.splits = assign(sorted(self._files), options.split)
        self.frames: int | None = None
        self.notes: list[str] = []
        known = options.given(("dt", "particle_radius"), **_CONSTANTS)
        self.header = Header(
            scene=folder.resolve().name,
            solver="DFSPH",
            solver_version="unknown",
            solver_parameters={"source": "DeepLagrangianFluids"},
            support_radius=4 * known["particle_radius"],
            **known,
        )

    def open(self, split: str, name: str) -> Simulation:
        paths = self._files[name]
        first = read_records(paths[0])[0]
        walls = np.asarray(first["box"], np.float32)
        return Simulation(
            self._scene(first, walls),
            lambda: _frames(paths, walls),
            walls,
            {"solid_normal": np.asarray(first["box_normals"], np.float32)},
        )

    def _scene(self, first: Record, walls: Array) -> SceneAttributes:
        volume = (2 * self.header.particle_radius) ** 3
        values = self._options.given(
            ("gravity", "viscosity", "density0"),
            gravity=_CONSTANTS["gravity"],
            viscosity=self._one("viscosity", first["viscosity"]),
            # Float32 holds seven digits of the mass.
            density0=self._one("density0", np.round(np.divide(first["m"], volume), 3)),
        )
        return SceneAttributes(**self._options.box(walls), **values)

    def _one(self, name: str, values: ArrayLike) -> float | None:
        """Return the value that all particles share; None if an option says another."""
        least, most = float(np.min(values)), float(np.max(values))
        if getattr(self._options, name) is not None:
            return None
        if most - least > 1e-5 * most:
            raise UserError(
                f"its fluids differ in {name}, {least:g} to {most:g}, and a simulation has one; "
                f"give one for all with --{name}, or leave the simulation out."
            )
        return float(np.float32(least)) if name == "density0" else float(f"{least:.6g}")


def read_records(path: Path) -> list[Record]:
    """Read a file of frames.

    Raises:
        UserError: A package is missing, or the file is damaged or of another format.
    """
    try:
        import msgpack
        import zstandard
    except ImportError as error:
        raise UserError(
            "DeepLagrangianFluids data needs msgpack and zstandard: install them with "
            "`pip install 'fluidsnet[convert]'`."
        ) from error
    try:
        with path.open("rb") as file, zstandard.ZstdDecompressor().stream_reader(file) as stream:
            records: list[Record] = msgpack.unpackb(stream.read(), object_hook=_array)
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        msgpack.UnpackException,
        zstandard.ZstdError,
    ) as error:
        raise UserError(f"{path}: the file is damaged or of another format: {error}.") from error
    if not isinstance(records, list) or not records or not isinstance(records[0], dict):
        raise UserError(f"{path}: it holds no list of frames.")
    for index, record in enumerate(records):
        expected = ["frame_id", "pos", "vel", "m", "viscosity"]
        expected += ["box", "box_normals"] if index == 0 else []
        if missing := [name for name in expected if name not in record]:
            raise UserError(f"{path}: frame {index} has no {', '.join(missing)}.")
        for name in {"pos", "vel", "box", "box_normals"} & record.keys():
            if np.ndim(record[name]) != 2 or np.shape(record[name])[1] != 3:
                raise UserError(
                    f"{path}: {name} of frame {index} has shape {np.shape(record[name])}; "
                    "expected (N, 3)."
                )
    return records


def _array(value: dict[Any, Any]) -> Any:
    """Decode an array or a number as ``msgpack_numpy`` encodes it.

    That package is not used: it unpickles, and so runs, what a file says are objects.
    """
    if b"nd" not in value:
        return value
    kind = np.dtype(value[b"type"])
    if kind.hasobject:
        raise ValueError("it holds Python objects")
    data = np.frombuffer(value[b"data"], kind)
    return data.reshape(value[b"shape"]) if value[b"nd"] else data[0]


def _frames(paths: list[Path], walls: Array) -> Iterator[Frame]:
    """Yield the frames of a simulation, one file in memory at a time."""
    last = None
    for path in paths:
        records = read_records(path)
        if not np.array_equal(records[0]["box"], walls):
            raise UserError(f"{path}: its box is another one than that of {paths[0].name}.")
        for record in records:
            number = int(record["frame_id"])
            if last is not None and number != last + 1:
                raise UserError(
                    f"{path}: frame {number} follows frame {last}; a file of the simulation is "
                    "missing."
                )
            last = number
            yield Frame(record["pos"], record["vel"])
