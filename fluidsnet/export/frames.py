"""Frames of particles on their way to the files of other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fluidsnet.errors import UserError
from fluidsnet.export.vtkhdf import read_attributes, read_field_data, read_frame


@dataclass(frozen=True)
class Frame:
    """Particles at one time.

    Attributes:
        time: s.
        position: (N, 3), m, float32; float64 where the source has that.
        velocity: (N, 3), m/s, float32.
    """

    time: float
    position: NDArray[Any]
    velocity: NDArray[np.float32]

    @classmethod
    def of(cls, time: float, position: NDArray[Any], velocity: NDArray[Any]) -> Frame:
        """Create a frame from arrays of any floating-point type and byte order."""
        wide = position.dtype.itemsize > 4
        return cls(
            time,
            np.ascontiguousarray(position, np.float64 if wide else np.float32),
            np.ascontiguousarray(velocity, np.float32),
        )

    @property
    def ids(self) -> NDArray[np.int32]:
        """Numbers of the particles (N,): their rows, which are the same in every frame."""
        return np.arange(len(self.position), dtype=np.int32)


@dataclass(frozen=True)
class Frames:
    """Sequence of frames that are read one by one.

    Attributes:
        name: Name of the source, for messages.
        times: (T,), s.
        indices: (T,) numbers of the frames in the source.
        read: Reads the frame of a number.
        particle_radius: m; None if the source does not have it.
        gravity: m/s².
        dimension: 2 or 3.
    """

    name: str
    times: NDArray[np.float64]
    indices: range
    read: Callable[[int], Frame]
    particle_radius: float | None = None
    gravity: tuple[float, float, float] = (0.0, -9.81, 0.0)
    dimension: int = 3

    def __len__(self) -> int:
        return len(self.indices)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.read, self.indices)

    def select(self, first: int, last: int, every: int) -> Frames:
        """Return a part of the frames.

        Args:
            first: Index of the first frame; negative counts from the end.
            last: Index of the last frame, which is included; negative counts from the end.
            every: Distance from a frame to the next.

        Raises:
            UserError: There is no such frame.
        """
        count = len(self)
        for option, index in (("first", first), ("last", last)):
            if not -count <= index < count:
                raise UserError(
                    f"--{option} is {index}; {self.name} has the frames 0 to {count - 1}."
                )
        if every < 1:
            raise UserError(f"--every is {every}; set at least 1.")
        start, end = first % count, last % count
        if start > end:
            raise UserError(f"--first is {first} and --last {last}; no frame lies between them.")
        part = slice(start, end + 1, every)
        return replace(self, times=self.times[part], indices=self.indices[part])

    def radius(self) -> float:
        """Return the particle radius, m.

        Raises:
            UserError: The source does not have it.
        """
        if self.particle_radius is None:
            raise UserError(f"{self.name} does not say its particle radius; give it with --radius.")
        return self.particle_radius


def trajectory_frames(path: Path) -> Frames:
    """Return the frames of a trajectory file (`fluidsnet.export.vtkhdf`).

    Raises:
        UserError: It is not a whole trajectory file, or has no velocities.
    """
    times = read_field_data(path)["time"]
    if not len(times):
        raise UserError(f"{path}: the file has no frame.")
    attributes = read_attributes(path)

    def read(step: int) -> Frame:
        position, point_data = read_frame(path, step)
        if "velocity" not in point_data:
            raise UserError(f"{path}: the point data velocity is missing.")
        return Frame.of(float(times[step]), position, point_data["velocity"])

    frames = Frames(str(path), times, range(len(times)), read)
    if "particle_radius" in attributes:
        frames = replace(frames, particle_radius=float(attributes["particle_radius"]))
    if "gravity" in attributes:
        x, y, z = (float(value) for value in attributes["gravity"])
        frames = replace(frames, gravity=(x, y, z))
    if "dimension" in attributes:
        frames = replace(frames, dimension=int(attributes["dimension"]))
    return frames
