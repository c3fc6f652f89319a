"""Folders of frames: a folder for each simulation, and a file for each time.

Formats are VTK (as SPlisHSPlasH and DualSPHysics export it), PLY, and BGEO. The frames of a
folder are the files whose names differ in the number before the suffix alone. Particles with a
number (a field such as ``id``) are sorted by it; rows of others are taken as they are.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import final

import numpy as np

from datamodules.convert.bgeo_file import read_bgeo
from datamodules.convert.differences import with_velocities
from datamodules.convert.options import Options
from datamodules.convert.ply_file import read_ply
from datamodules.convert.points import Points
from datamodules.convert.simulation import NO_SOLIDS, Array, Frame, Simulation
from datamodules.convert.splits import assign
from datamodules.convert.vtk_file import read_vtk
from datamodules.schema import Header, SceneAttributes
from fluidsnet.errors import UserError

READERS: dict[str, Callable[[Path], Points]] = {
    ".vtk": read_vtk,
    ".vtp": read_vtk,
    ".vtu": read_vtk,
    ".ply": read_ply,
    ".bgeo": read_bgeo,
    ".bgeo.gz": read_bgeo,
}
_NAME = re.compile(
    r"(?P<stem>.*?)(?P<number>\d+)(?P<suffix>\.(?:vtk|vtp|vtu|ply|bgeo|bgeo\.gz))", re.IGNORECASE
)

#: Folders that SPlisHSPlasH adds below that of a simulation.
_EXPORTS = ("vtk", "partio")

#: Files of one kind of particles by the number of the frame.
Sequence = dict[int, Path]


def has_frames(folder: Path) -> bool:
    """Return whether there are files of frames in a folder or below it."""
    return any(_NAME.fullmatch(path.name) for path in folder.rglob("*"))


@final
class FrameFolders:
    """Simulations that are folders of frames.

    Args:
        folder: Folder with a folder for each simulation, or that of one simulation.
        options: Options of the conversion.

    Raises:
        UserError: The frames cannot be told apart, or an option is missing.
    """

    def __init__(self, folder: Path, options: Options) -> None:
        self._options = options
        self._sequences: dict[str, list[Sequence]] = {}
        for parent in sorted({path.parent for path in folder.rglob("*") if _is_frame(path)}):
            sequences = _sequences(parent, options.frames)
            if not sequences:
                continue
            below = parent.relative_to(folder).parts
            below = below[:-1] if below and below[-1] in _EXPORTS else below
            name = "/".join(below) or folder.resolve().name
            if name in self._sequences:
                raise UserError(
                    f"{folder}: {name} has frames in several folders; choose with --frames, as in "
                    "--frames '*.vtk'."
                )
            self._sequences[name] = sequences
        if not self._sequences:
            raise UserError(
                f"{folder} has no frames, files such as fluid_0001.vtk, whose names match "
                f"{' or '.join(options.frames or ['*'])}."
            )
        self._values = options.given(
            ("dt", "particle_radius", "gravity", "viscosity", "density0"), density0=1000.0
        )
        self._walls = self._read_walls()
        self._box = options.box(self._walls)
        self.splits = assign(sorted(self._sequences), options.split)
        self.frames: int | None = sum(
            len(self._sequences[name][0]) for names in self.splits.values() for name in names
        )
        self.notes: list[str] = []
        radius = self._values["particle_radius"]
        self.header = Header(
            scene=folder.resolve().name,
            solver="unknown",
            solver_version="unknown",
            solver_parameters={},
            particle_radius=radius,
            support_radius=4 * radius,
            dt=self._values["dt"],
        )

    def open(self, split: str, name: str) -> Simulation:
        sequences = self._sequences[name]
        first = [_read(next(iter(sequence.values()))) for sequence in sequences]
        have_velocity = all(points.velocity() is not None for points in first)
        if not have_velocity:
            fields = ", ".join(dict.fromkeys(it for points in first for it in points.fields))
            self.notes.append(
                f"{name} has no velocities (fields: {fields or 'none'}); they are differences of "
                "the positions"
            )
        if any(points.numbers() is None for points in first):
            self.notes.append(
                f"{name} has no numbers of the particles; row i is taken for the same one in all "
                "frames"
            )
        values = {it: self._values[it] for it in ("gravity", "viscosity", "density0")}
        return Simulation(
            SceneAttributes(**self._box, **values),
            lambda: self._frames(sequences, have_velocity),
            self._walls,
        )

    def _frames(self, sequences: list[Sequence], have_velocity: bool) -> Iterator[Frame]:
        if have_velocity:
            for position, velocity in _states(sequences):
                if velocity is None:
                    raise UserError("some of its frames have no velocity.")
                yield Frame(position, velocity)
        else:
            positions = (position for position, _ in _states(sequences))
            for state in with_velocities(positions, self.header.dt, np.zeros(3)):
                yield Frame(*state)

    def _read_walls(self) -> Array:
        if self._options.walls is None:
            return NO_SOLIDS
        path = Path(self._options.walls)
        if not path.is_file() or _suffix(path) not in READERS:
            raise UserError(
                f"--walls {path}: expected a file of particles, {', '.join(READERS)}; sample "
                "a mesh first."
            )
        return np.asarray(READERS[_suffix(path)](path).position, np.float32)


def _is_frame(path: Path) -> bool:
    return _NAME.fullmatch(path.name) is not None and path.is_file()


def _suffix(path: Path) -> str:
    return ".bgeo.gz" if path.name.lower().endswith(".bgeo.gz") else path.suffix.lower()


def _sequences(folder: Path, patterns: list[str] | None) -> list[Sequence]:
    """Return the sequences of frames in a folder, one for each pattern, or its only one."""
    found: dict[str, Sequence] = {}
    for path in folder.iterdir():
        if match := _NAME.fullmatch(path.name):
            key = f"{match['stem']}*{match['suffix']}"
            found.setdefault(key, {})[int(match["number"])] = path
    chosen = []
    for pattern in patterns or ["*"]:
        matches = {
            key: sequence
            for key, sequence in found.items()
            if fnmatchcase(next(iter(sequence.values())).name, pattern)
        }
        if len(matches) > 1:
            names = ", ".join(f"'{key}'" for key in sorted(matches))
            raise UserError(
                f"{folder} has frames of several names; choose those of the fluid with --frames, "
                f"one or more of {names}; the fluids of several are joined."
            )
        chosen += [dict(sorted(sequence.items())) for sequence in matches.values()]
    for sequence in chosen:
        _check_numbers(folder, sequence, chosen[0])
    return chosen


def _check_numbers(folder: Path, sequence: Sequence, first: Sequence) -> None:
    numbers = list(sequence)
    steps = np.diff(numbers)
    if (steps != steps[:1]).any():
        index = int(np.flatnonzero(steps != steps[0])[0])
        raise UserError(
            f"{folder}: after {sequence[numbers[index]].name} comes "
            f"{sequence[numbers[index + 1]].name}, and the numbers before rise by {steps[0]}; a "
            "frame is missing."
        )
    if numbers != list(first):
        raise UserError(f"{folder}: the sequences of --frames have different numbers of frames.")


def _read(path: Path) -> Points:
    points = READERS[_suffix(path)](path).sorted()
    if points.position.ndim != 2 or points.position.shape[1] != 3:
        raise UserError(f"{path}: its positions have shape {points.position.shape}.")
    return points


def _states(sequences: list[Sequence]) -> Iterator[tuple[Array, Array | None]]:
    """Yield position and velocity of each frame, the same particle in a row of all."""
    numbers: list[Array | None] | None = None
    for paths in zip(*(sequence.values() for sequence in sequences), strict=True):
        parts = [_read(path) for path in paths]
        found = [points.numbers() for points in parts]
        numbers = numbers or found
        for path, before, now in zip(paths, numbers, found, strict=True):
            _check_same(path, before, now)
        velocities = [points.velocity() for points in parts]
        position = np.concatenate([points.position for points in parts])
        whole = [velocity for velocity in velocities if velocity is not None]
        yield position, np.concatenate(whole) if len(whole) == len(parts) else None


def _check_same(path: Path, before: Array | None, now: Array | None) -> None:
    """Check that a frame has the particles of the first one, given their sorted numbers."""
    if (before is None) != (now is None):
        raise UserError(f"{path}: some frames have numbers of particles, and others none.")
    if before is None or now is None:
        return
    if len(np.unique(now)) < len(now):
        raise UserError(f"{path}: two particles have the same number.")
    if not np.array_equal(before, now):
        gone, new = np.setdiff1d(before, now), np.setdiff1d(now, before)
        raise UserError(
            f"{path}: it has other particles than the first frame ({len(gone)} are missing, "
            f"{len(new)} are new); inlets, outlets and emitters are not supported, so leave the "
            "simulation out."
        )
