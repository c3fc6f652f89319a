"""Lazy reader of the frames of a data file."""

from __future__ import annotations

import hashlib
import os
from functools import cached_property
from pathlib import Path
from typing import Any, SupportsFloat, final

import h5py
import torch
from torch import Tensor

from datamodules.schema import DAMAGE, VECTORS, Header, open_valid, simulations
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
        UserError: the file is missing, damaged or not a data file, or its solids move.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._handle: h5py.File | None = None
        self._process = -1
        self._solids: dict[str, Tensor] = {}
        self._scenes: dict[int, Scene] = {}
        self.frames: dict[str, int] = {}
        with open_valid(path) as file:
            self.header = Header.read(file)
            for name in simulations(file):
                if file[name]["solid_position"].ndim == 3:
                    raise UserError(
                        f"{path}: the solids of /{name} move; only solids at rest are supported."
                    )
                self.frames[name] = len(file[name]["position"])

    @cached_property
    def sha256(self) -> str:
        """SHA-256 hash of the file, in hexadecimal."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def scene(self, stride: int) -> Scene:
        """Return the scene of the file for steps of this many frames, always the same object."""
        header = self.header
        if stride not in self._scenes:
            # Kept for training too, where a tensor made in inference mode cannot be used.
            with torch.inference_mode(False):
                lower, upper, gravity = (
                    torch.tensor(getattr(header, name), dtype=torch.float32) for name in VECTORS
                )
                radius, support, dt = header.particle_radius, header.support_radius, header.dt
                self._scenes[stride] = Scene(lower, upper, gravity, radius, support, dt * stride)
        return self._scenes[stride]

    def check_same_scene(self, other: FrameReader) -> None:
        """Raise a `UserError` if another file has another scene or frame interval."""
        for name in (*VECTORS, "particle_radius", "support_radius", "dt"):
            value, expected = getattr(self.header, name), getattr(other.header, name)
            if value != expected:
                raise UserError(
                    f"{self.path}: {name} is {value}, and {expected} in {other.path.name}; "
                    "the files of a data set must have one scene."
                )

    def fluid(self, simulation: str, frame: int) -> tuple[Tensor, Tensor]:
        """Read position, m, and velocity, m/s, of the fluid particles, each (N, 3)."""
        what = f"frame {frame} of /{simulation}"
        position = self._read(f"{simulation}/position", frame, what)
        return position, self._read(f"{simulation}/velocity", frame, what)

    def state(self, simulation: str, frame: int, scene: Scene) -> Particles:
        """Read one frame with its solids."""
        position, velocity = self.fluid(simulation, frame)
        if simulation not in self._solids:
            what = f"the solids of /{simulation}"
            self._solids[simulation] = self._read(f"{simulation}/solid_position", (), what)
        return Particles.single(position, velocity, self._solids[simulation], scene)

    def close(self) -> None:
        """Close the handle of this process, if it is open; the next read opens it again."""
        if self._handle is not None and self._process == os.getpid():
            self._handle.close()
        self._handle = None

    def _read(self, name: str, index: int | tuple[()], what: str) -> Tensor:
        try:
            return torch.from_numpy(self._file()[name][index]).float()
        except DAMAGE as error:
            raise UserError(
                f"{self.path}: {what} cannot be read; the file is damaged or gone ({error})."
            ) from error

    def _file(self) -> h5py.File:
        if self._handle is None or self._process != os.getpid():
            if self._handle is not None:
                # Inherited across a fork; h5py would return it again while it is open.
                self._handle.close()
            self._handle = h5py.File(self.path, "r")
            self._process = os.getpid()
        return self._handle

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_handle": None, "_process": -1}


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
    state = reader.state(name, frame, reader.scene(stride))
    reader.close()
    return state
