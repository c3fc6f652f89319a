"""Lazy reader of the frames of a data file."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, SupportsFloat, final

import h5py
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datamodules.damage import is_zero
from datamodules.schema import DAMAGE, LENGTHS, Header, SceneAttributes, open_valid, simulations
from datamodules.storage import open_file
from datamodules.values import NO_ORIGIN, Vector, as_tensor, check_finite, origin_of
from fluidsnet.checksums import sha256_of
from fluidsnet.errors import UserError
from fluidsnet.particles import Particles
from fluidsnet.scene import Scene


@final
class FrameReader:
    """Reader of the simulations in one file.

    The file is opened when a frame is first read, once in each process: a handle is never
    pickled and never shared across a fork.

    Args:
        path: Path of a data file.

    Attributes:
        frames: Number of frames of each simulation, by name, in order of names.

    Raises:
        UserError: the file is missing, damaged, not a data file, or not that of its checksum.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._handle: h5py.File | None = None
        self._process = -1
        # Of solids at rest.
        self._solids: dict[str, Tensor] = {}
        self._moving: set[str] = set()
        self._scenes: dict[tuple[str, int], Scene] = {}
        self._attributes: dict[str, SceneAttributes] = {}
        self._origins: dict[str, Vector] = {}
        self.frames: dict[str, int] = {}
        with open_valid(path) as file:
            self.header = Header.read(file)
            for name in simulations(file):
                radius = self.header.particle_radius
                self._attributes[name] = _flat(file[name], radius)
                self._origins[name] = origin_of(self._attributes[name], radius)
                self.frames[name] = len(file[name]["position"])
                if file[name]["solid_position"].ndim == 3:
                    self._moving.add(name)
        if len({it.periodic for it in self._attributes.values()}) > 1:
            raise UserError(f"{path}: some simulations have periodic axes that others do not.")

    @cached_property
    def sha256(self) -> str:
        """SHA-256 hash of the file, in hexadecimal."""
        return sha256_of(self.path)

    @property
    def _periodic(self) -> tuple[bool, bool, bool]:
        return next(iter(self._attributes.values())).periodic

    def scene(self, simulation: str, stride: int) -> Scene:
        """Return the scene of a simulation for steps of this many frames, always the same object.

        Its name is the file's and the simulation's, such as test/00000. Positions are relative to
        its origin, which is zero unless the box is far from there.
        """
        if (simulation, stride) not in self._scenes:
            attributes, header = self._attributes[simulation], self.header
            origin = self._origins[simulation]
            # Kept for training too, where a tensor made in inference mode cannot be used.
            with torch.inference_mode(False):
                self._scenes[simulation, stride] = Scene.single(
                    np.subtract(attributes.domain_lower, origin).tolist(),
                    np.subtract(attributes.domain_upper, origin).tolist(),
                    attributes.gravity,
                    header.particle_radius,
                    header.support_radius,
                    time_step=header.dt * stride,
                    density0=attributes.density0,
                    viscosity=attributes.viscosity,
                    surface_tension=attributes.surface_tension,
                    name=f"{self.path.stem}/{simulation}",
                    dimension=attributes.dimension,
                    origin=origin,
                    periodic=attributes.periodic,
                )
        return self._scenes[simulation, stride]

    def scenes(self, stride: int) -> list[Scene]:
        """Return the scenes of all simulations for steps of this many frames."""
        return [self.scene(simulation, stride) for simulation in self.frames]

    def check_same_resolution(self, other: FrameReader) -> None:
        """Raise a `UserError` if another file has another resolution, interval or periodicity."""
        for name in LENGTHS:
            value, expected = getattr(self.header, name), getattr(other.header, name)
            if value != expected:
                raise UserError(
                    f"{self.path}: {name} is {value}, and {expected} in {other.path.name}; "
                    "the files of a data set must have one resolution and frame interval."
                )
        if self._periodic != other._periodic:
            raise UserError(f"{self.path} and {other.path.name} have different periodic axes.")

    def fluid(self, simulation: str, frame: int) -> tuple[Tensor, Tensor]:
        """Read position, m, and velocity, m/s, of the fluid particles, each (N, 3)."""
        what = f"frame {frame} of /{simulation}"
        names = f"{simulation}/position", f"{simulation}/velocity"
        values = self._values(names[0], frame, what)
        if is_zero(values):
            raise UserError(
                f"{self.path}: {what} is all zero; leave it out with data.frame_range, or write "
                "the file again without it. `fluidsnet inspect` lists such frames."
            )
        return self._finite(values, names[0], what), self._read(names[1], frame, what)

    def state(self, simulation: str, frame: int, stride: int) -> Particles:
        """Read one frame with its solids, in the scene for steps of this many frames."""
        position, velocity = self.fluid(simulation, frame)
        scene = self.scene(simulation, stride)
        solids, speeds = self.solids(simulation, frame)
        state = Particles.single(position, velocity, solids, scene)
        return state.with_solids(solids, speeds) if simulation in self._moving else state

    def solids(self, simulation: str, frame: int) -> tuple[Tensor, Tensor]:
        """Read position, m, and velocity, m/s, of the solid particles, each (M, 3)."""
        what = f"the solids of frame {frame} of /{simulation}"
        names = f"{simulation}/solid_position", f"{simulation}/solid_velocity"
        if simulation in self._moving:
            position, velocity = (self._read(name, frame, what) for name in names)
            return position, velocity
        if simulation not in self._solids:
            self._solids[simulation] = self._inside(simulation, self._read(names[0], (), what))
        position = self._solids[simulation]
        return position, torch.zeros_like(position)

    def _inside(self, simulation: str, solids: Tensor) -> Tensor:
        """Return solids at rest; those across a periodic face would count twice.

        Raises:
            UserError: Some are there.
        """
        scene = self.scene(simulation, 1)
        beyond = torch.maximum(scene.domain_lower - solids, solids - scene.domain_upper)
        outside = beyond > 1e-3 * scene.particle_radius
        count = int((outside & torch.tensor(scene.periodic)).any(dim=1).sum())
        if count:
            raise UserError(
                f"{self.path}: {count} solids of /{simulation} are outside the domain along a "
                "periodic axis, where they repeat others; leave them out of the file."
            )
        return solids

    def motion(self, simulation: str, first: int, stride: int) -> SolidTrack | None:
        """Return the motion of the solids from a frame on; None where they rest."""
        return SolidTrack(self, simulation, first, stride) if simulation in self._moving else None

    def close(self) -> None:
        """Close the handle of this process, if it is open; the next read opens it again."""
        if self._handle is not None and self._process == os.getpid():
            self._handle.close()
        self._handle = None

    def _read(self, name: str, index: int | tuple[()], what: str) -> Tensor:
        return self._finite(self._values(name, index, what), name, what)

    def _values(self, name: str, index: int | tuple[()], what: str) -> NDArray[Any]:
        """Read values as they are stored."""
        try:
            values: NDArray[Any] = self._file()[name][index]
        except DAMAGE as error:
            raise UserError(
                f"{self.path}: {what} cannot be read; the file is damaged or gone ({error})."
            ) from error
        return values

    def _finite(self, values: NDArray[Any], name: str, what: str) -> Tensor:
        """Return values as float32, relative to the origin; they must be finite."""
        simulation, _, data = name.partition("/")
        origin = self._origins[simulation] if data.endswith("position") else NO_ORIGIN
        read = as_tensor(values, origin)
        check_finite(read, self.path, data, what)
        return read

    def _file(self) -> h5py.File:
        if self._handle is None or self._process != os.getpid():
            if self._handle is not None:
                # Inherited across a fork; h5py would return it again while it is open.
                self._handle.close()
            self._handle = open_file(self.path)
            self._process = os.getpid()
        return self._handle

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_handle": None, "_process": -1}


@final
class SolidTrack:
    """Motion of the solids of a simulation from a frame on, read one state at a time.

    Args:
        reader: Reader of the file.
        simulation: Name of the simulation.
        first: Frame of the start.
        stride: Frames from a state to the next.
    """

    def __init__(self, reader: FrameReader, simulation: str, first: int, stride: int) -> None:
        self.reader, self.simulation = reader, simulation
        self.first, self.stride = first, stride

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        """Return position and velocity after a step.

        Raises:
            UserError: The file ends before.
        """
        frame, known = self.first + step * self.stride, self.reader.frames[self.simulation]
        if not 0 <= frame < known:
            raise UserError(
                f"{self.reader.path}: the solids of /{self.simulation} move, and their motion is "
                f"known for {known} frames, fewer than {frame + 1}."
            )
        return self.reader.solids(self.simulation, frame)


def _flat(group: h5py.Group, particle_radius: float) -> SceneAttributes:
    """Return the scene of a simulation; in two dimensions its box is one particle deep."""
    scene = SceneAttributes.read(group)
    if scene.dimension == 3:
        return scene
    plane = float(group["position"][0, 0, 2])
    return replace(
        scene,
        domain_lower=(*scene.domain_lower[:2], plane - particle_radius),
        domain_upper=(*scene.domain_upper[:2], plane + particle_radius),
        gravity=(*scene.gravity[:2], 0.0),
        periodic=(*scene.periodic[:2], False),
    )


def read_state(
    path: str | Path, time_step: SupportsFloat, frame: int = 0, simulation: str | None = None
) -> Particles:
    """Read one frame of a data file as a state that a model can step.

    Args:
        path: Path of a data file, such as data/demo/test.h5.
        time_step: Time step of the model, s (`Model.time_step`).
        frame: Number of the frame.
        simulation: Name of the simulation, such as "00000"; the first by default.

    Raises:
        UserError: the file cannot be read, the frame is not there, or the time step is not a
            multiple of the file's frame interval.
    """
    reader, name, stride = _find(path, time_step, frame, simulation)
    state = reader.state(name, frame, stride)
    reader.close()
    return state


def read_motion(
    path: str | Path, time_step: SupportsFloat, frame: int = 0, simulation: str | None = None
) -> SolidTrack | None:
    """Return the motion of the solids after a frame, for a rollout from it; None if they rest.

    Arguments and errors are those of `read_state`.
    """
    reader, name, stride = _find(path, time_step, frame, simulation)
    return reader.motion(name, frame, stride)


def _find(
    path: str | Path, time_step: SupportsFloat, frame: int, simulation: str | None
) -> tuple[FrameReader, str, int]:
    """Return a reader, the name of the simulation, and the number of frames in a step."""
    reader = FrameReader(Path(path))
    name = next(iter(reader.frames)) if simulation is None else simulation
    if not 0 <= frame < reader.frames.get(name, 0):
        raise UserError(f"{path}: there is no frame {frame} of /{name}.")
    interval, step = reader.header.dt, float(time_step)
    stride = round(step / interval)
    if stride < 1 or abs(stride * interval - step) > 1e-6 * step:
        raise UserError(
            f"{path}: a time step of {step:g} s is no multiple of the frame interval, "
            f"{interval:g} s."
        )
    return reader, name, stride
