"""LagrangeBench: positions of particles in HDF5 files, beside a ``metadata.json``.

Toshev et al. 2023, https://arxiv.org/abs/2309.16342. A folder has ``train.h5``, ``valid.h5`` and
``test.h5``. Their groups, one for each simulation, have ``position`` (T, N, dimension) and
``particle_type`` (N,). There are no velocities: they are differences of the positions
(`with_velocities`). Units are those of the data, read as m and s.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, final

import h5py
import numpy as np

from datamodules.convert.chunked_frames import read_frames
from datamodules.convert.differences import with_velocities
from datamodules.convert.lagrangebench_metadata import read_metadata
from datamodules.convert.options import Options
from datamodules.convert.simulation import NO_SOLIDS, Array, Frame, Simulation
from datamodules.guard import guarded
from datamodules.schema import DAMAGE, Header, SceneAttributes
from datamodules.storage import check_links, check_stored
from fluidsnet.errors import UserError

#: Files of the splits.
FILES = {"train": "train.h5", "val": "valid.h5", "test": "test.h5"}

#: Values of `particle_type` (``lagrangebench.utils.NodeType``).
PADDING, FLUID, WALL, MOVING_WALL, RIGID_BODY = -1, 0, 1, 2, 3

#: Key of `solver_parameters` that keeps the metadata of the source.
METADATA = "lagrangebench_metadata"

_OPTIONS = frozenset({"gravity", "domain", "viscosity", "density0", "particle_radius", "dt"})


def is_lagrangebench(folder: Path) -> bool:
    """Return whether a folder has this format."""
    return (folder / "metadata.json").is_file() and any(
        (folder / name).is_file() for name in FILES.values()
    )


@final
class LagrangeBench:
    """Data set of LagrangeBench.

    Args:
        folder: Its folder.
        options: Options of the conversion.

    Raises:
        UserError: The metadata cannot be read, or does not say all that is needed.
    """

    def __init__(self, folder: Path, options: Options) -> None:
        options.refuse_others(_OPTIONS, "LagrangeBench data")
        self._folder, self._options = folder, options
        self._metadata = metadata = read_metadata(folder / "metadata.json")
        self.notes: list[str] = []
        spacing = metadata.get("dx")
        known = options.given(
            ("dt", "particle_radius"),
            dt=metadata["dt"] * metadata.get("write_every", 1),
            particle_radius=spacing and spacing / 2,
        )
        self.header = Header(
            scene=str(metadata.get("case", folder.name)),
            solver=str(metadata.get("solver", "unknown")),
            solver_version=str(metadata.get("solver_version", "unknown")),
            solver_parameters=metadata.get("solver_parameters", {METADATA: metadata}),
            support_radius=metadata.get("support_radius", 4 * known["particle_radius"]),
            **known,
        )
        found = {split: folder / name for split, name in FILES.items()}
        lengths = {split: _lengths(path) for split, path in found.items() if path.is_file()}
        self.splits = {split: [*simulations] for split, simulations in lengths.items()}
        self.frames: int | None = sum(sum(it.values()) for it in lengths.values())
        self._explain_forces()

    def _explain_forces(self) -> None:
        """Note what is done about forces; raise a `UserError` if they are not known."""
        code = (self._folder / "force.py").is_file()
        what = (
            "its external force is in force.py, which is code and is not run"
            if code
            else "metadata.json has the size of the external force and not its direction"
        )
        if "gravity" in self._metadata:
            return
        if not (code or self._metadata.get("g_ext_magnitude")):
            if self._options.gravity is None:
                self.notes.append("metadata.json names no external force; gravity is zero")
            return
        if self._options.gravity is None:
            raise UserError(
                f"{self._folder}: {what}; give a constant one with --gravity X Y Z, in the units "
                "of the data."
            )
        self.notes.append(f"{what}; it is taken as the constant {self._options.gravity}")

    def open(self, split: str, name: str) -> Simulation:
        path = self._folder / FILES[split]
        with _open(path) as file:
            group = file[name]
            kind = _particle_type(group)
            scene = self._scene(group)
            plane = float(group.attrs.get("plane", 0.0))
            periods = np.where(
                scene.periodic, np.subtract(scene.domain_upper, scene.domain_lower), 0.0
            )
            solid = np.isin(kind, (WALL, MOVING_WALL))
            rest = _at_rest(group, solid)
            if rest and (kind == MOVING_WALL).any():
                self.notes.append(f"{path.name}: the moving walls of /{name} rest in all frames")
            walls = _flat(group["position"][0][solid], plane) if rest else NO_SOLIDS
            datasets = {it: group[it][()] for it in ("time", "solver_seconds") if it in group}
            further = set(SceneAttributes.__dataclass_fields__) | {"plane"}
            attributes = {it: group.attrs[it] for it in group.attrs if it not in further}

        def frames() -> Iterator[Frame]:
            with _open(path) as file:
                for position, velocity in self._states(file[name], periods, plane):
                    fluid = position[kind == FLUID], velocity[kind == FLUID]
                    moving = () if rest else (position[solid], velocity[solid])
                    yield Frame(*fluid, *moving)

        return Simulation(scene, frames, walls, {"particle_type": kind, **datasets}, attributes)

    def _scene(self, group: h5py.Group) -> SceneAttributes:
        """Return the scene of a simulation: attributes written by FluidsNet, or the metadata."""
        metadata, options, radius = self._metadata, self._options, self.header.particle_radius
        if _is_own(group):
            scene = SceneAttributes.read(group)
            known: dict[str, Any] = {
                "gravity": scene.gravity,
                "viscosity": scene.viscosity,
                "density0": scene.density0,
            }
        else:
            bounds = np.array([*metadata["bounds"], [-radius, radius]][:3], np.float64)
            axes = map(bool, metadata["periodic_boundary_conditions"][: metadata["dim"]])
            x, y, z, *_ = [*axes, False]
            scene = SceneAttributes(
                domain_lower=tuple(bounds[:, 0].tolist()),
                domain_upper=tuple(bounds[:, 1].tolist()),
                gravity=(0.0, 0.0, 0.0),
                density0=1.0,
                viscosity=0.0,
                periodic=(x, y, z),
                dimension=int(metadata["dim"]),
            )
            known = {"gravity": [0.0] * 3, "viscosity": metadata.get("viscosity"), "density0": 1.0}
        values = options.given(("gravity", "viscosity", "density0"), **known)
        if options.domain is not None:
            if any(scene.periodic):
                raise UserError("its box is periodic, and bounds are the period; omit --domain.")
            values |= options.box(NO_SOLIDS)
        return replace(scene, **values)

    def _states(
        self, group: h5py.Group, periods: Array, plane: float
    ) -> Iterator[tuple[Array, Array]]:
        """Yield position and velocity of all particles, each (N, 3)."""
        if _is_own(group):
            for position, velocity in zip(
                read_frames(group["position"]), read_frames(group["velocity"]), strict=True
            ):
                yield _flat(position, plane), _flat(velocity, 0.0)
        else:
            positions = (_flat(position, plane) for position in read_frames(group["position"]))
            yield from with_velocities(positions, self.header.dt, periods)


def _is_own(group: h5py.Group) -> bool:
    """Return whether FluidsNet wrote a simulation, with its scene and velocities in m/s."""
    return "domain_lower" in group.attrs and "velocity" in group


def _open(path: Path) -> h5py.File:
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise UserError(f"{path}: it is no whole HDF5 file: {error}.") from error


def _lengths(path: Path) -> dict[str, int]:
    """Return the number of frames of each simulation in a file, by name."""

    def read() -> dict[str, int]:
        with _open(path) as file:
            check_links(file)
            positions = {name: file[name].get("position") for name in sorted(file)}
            return {name: 0 if it is None else len(it) for name, it in positions.items()}

    guarded(path, read)
    try:
        return read()
    except (*DAMAGE, AttributeError, TypeError) as error:
        raise UserError(f"{path}: the file is damaged or of another format: {error}.") from error


def _particle_type(group: h5py.Group) -> Array:
    """Return the type of each particle, (N,); raise a `UserError` for what is not supported."""
    check_links(group)
    position, kind = group.get("position"), group.get("particle_type")
    if not isinstance(position, h5py.Dataset) or not isinstance(kind, h5py.Dataset):
        raise UserError("position or particle_type is missing.")
    check_stored(position)
    if position.ndim != 3 or kind.shape != position.shape[1:2]:
        raise UserError(
            f"position has shape {position.shape} and particle_type {kind.shape}; expected "
            "(T, N, dimension) and (N,)."
        )
    types = np.asarray(kind[()])
    if (types == RIGID_BODY).any():
        raise UserError(
            f"{int((types == RIGID_BODY).sum())} of its particles are of rigid bodies "
            "(particle_type 3), whose motion is not predicted; leave the simulation out."
        )
    if strange := sorted({*types.tolist()} - {PADDING, FLUID, WALL, MOVING_WALL}):
        raise UserError(
            f"particle_type has the value(s) {strange}; known are -1 (padding), 0 (fluid), 1 "
            "(wall) and 2 (moving wall)."
        )
    return types


def _at_rest(group: h5py.Group, solid: Array) -> bool:
    """Return whether the solids, (N,) booleans, are at the same places in all frames."""
    if not solid.any():
        return True
    if _is_own(group):
        return not any(velocity[solid].any() for velocity in read_frames(group["velocity"]))
    first = group["position"][0][solid]
    return all(
        np.array_equal(position[solid], first) for position in read_frames(group["position"])
    )


def _flat(values: Array, plane: float) -> Array:
    """Return vectors (N, 2) or (N, 3) as (N, 3), with the third coordinate of the plane."""
    if values.shape[1] == 3:
        return values
    return np.concatenate([values, np.full((len(values), 1), plane, values.dtype)], axis=1)
