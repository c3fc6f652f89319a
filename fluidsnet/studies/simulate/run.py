"""Rollout of a start to a VTKHDF file, frame by frame."""

from __future__ import annotations

import warnings
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from fluidsnet.export.vtkhdf import Array, TrajectoryFile
from fluidsnet.model import Model
from fluidsnet.particles import Particles
from fluidsnet.progress import Progress
from fluidsnet.reporting.file_places import file_attributes, file_places
from fluidsnet.rollout import rollout
from fluidsnet.studies.simulate.concerns import greatest_speed
from fluidsnet.studies.simulate.interruption import Interruption
from fluidsnet.studies.simulate.rest import RestWatch
from fluidsnet.studies.simulate.start import Start

#: Speed over that of a fall through the scene above which the fluid has burst apart.
_BURST = 6.0


@final
@dataclass
class Course:
    """End of a simulation, and what was stored of it.

    Attributes:
        path: File of the fluid.
        solids: File of the solids; None without solids.
        frames: Stored frames, the start included.
        time: Time of the last one, s.
        fastest: Greatest speed of a particle in a stored frame, m/s.
        bound: Speed of a fall through the scene, m/s.
        lower: (3,) least coordinates of the fluid in stored frames, m.
        upper: (3,) greatest coordinates, m.
        rested: The fluid came to rest.
        interrupted: Ctrl-C ended it.
        not_finite: Time after which a particle was not finite, s; None if all were.
    """

    path: Path
    solids: Path | None
    bound: float
    lower: Array
    upper: Array
    frames: int = 0
    time: float = 0.0
    fastest: float = 0.0
    rested: bool = False
    interrupted: bool = False
    not_finite: float | None = None

    @property
    def burst(self) -> bool:
        """Return whether the fluid was faster than it can be."""
        return self.fastest > _BURST * self.bound


def run(
    model: Model, start: Start, steps: int, every: int, folder: Path, rest: RestWatch | None
) -> Course:
    """Roll a start out and store its frames, which are whole whatever ends it.

    Args:
        model: Model in evaluation mode.
        start: Start, on the model's device.
        steps: Number of steps, at most.
        every: Steps between two stored frames; the last one is stored, too.
        folder: Folder of the files.
        rest: Ends the simulation when the fluid rests; None to go on.

    Raises:
        UserError: The files cannot be written.
    """
    state = start.state
    path, solids = folder / f"{start.name}.vtkhdf", folder / f"{start.name}_solids.vtkhdf"
    count = len(state.solid_position)
    infinite = np.full(3, np.inf)
    bound = max(greatest_speed(state), state.scene.particle_radius / state.scene.time_step)
    course = Course(path, solids if count else None, bound, infinite, -infinite)
    with Interruption() as interruption, ExitStack() as files, warnings.catch_warnings():
        # `concerns` has told them.
        warnings.simplefilter("ignore")
        attributes, solid_file = file_attributes(state.scene), None
        fluid_file = files.enter_context(TrajectoryFile(path, len(state), attributes))
        if count:
            solid_file = files.enter_context(TrajectoryFile(solids, count, attributes))
        _store(fluid_file, course, state, 0.0)
        if solid_file is not None:
            _store_solids(solid_file, state, 0.0)
        bar = files.enter_context(Progress(total=steps, unit="step", desc="simulating"))
        for step, after in enumerate(rollout(model, state, steps, start.solids), start=1):
            bar.update()
            if step % every and step < steps and not interruption.requested:
                continue
            time = step * state.scene.time_step
            speed = _store(fluid_file, course, after, time)
            if speed is None:
                course.not_finite = time
                break
            if solid_file is not None and start.solids is not None:
                _store_solids(solid_file, after, time)
            bar.set_postfix_str(_status(bar, time, speed))
            if interruption.requested:
                course.interrupted = True
                break
            if rest is not None and rest.at_rest(time, speed):
                course.rested = True
                break
    return course


def _store(file: TrajectoryFile, course: Course, state: Particles, time: float) -> Array | None:
    """Store a state; return the speeds (N,), m/s, or None if it is not finite and not stored."""
    place, velocity = file_places(state.position, state), state.velocity.cpu().numpy()
    if not (np.isfinite(place).all() and np.isfinite(velocity).all()):
        return None
    speed: Array = np.linalg.norm(velocity, axis=1)
    file.append(time, place, {"velocity": velocity, "speed": speed})
    course.frames, course.time = course.frames + 1, time
    course.fastest = max(course.fastest, float(speed.max()))
    course.lower = np.minimum(course.lower, place.min(axis=0))
    course.upper = np.maximum(course.upper, place.max(axis=0))
    return speed


def _store_solids(file: TrajectoryFile, state: Particles, time: float) -> None:
    velocity = state.solid_velocity.cpu().numpy()
    file.append(time, file_places(state.solid_position, state), {"velocity": velocity})


def _status(bar: Progress, time: float, speed: Array) -> str:
    """Return time, speed and, where the bar shows no time left, that."""
    status = f"at {time:.2f} s, up to {speed.max():.2g} m/s"
    left = (bar.total or 0) - bar.n
    if bar.fp.isatty() or not left:
        return status
    return f"{status}, {bar.format_interval(left * bar.format_dict['elapsed'] / bar.n)} left"
