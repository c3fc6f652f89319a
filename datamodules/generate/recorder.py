"""Recorder: checks and stores the frames of a running simulation."""

from __future__ import annotations

import os
from collections.abc import Callable
from types import ModuleType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.generate.job import Job
from datamodules.schema import COMPRESSION, create_frames


class EscapedError(RuntimeError):
    """A particle left the domain."""


class Recorder:
    """Writer of the frames of a simulation, started in the solver, to a group of an open file.

    The file descriptor `report` gets one line per frame.
    """

    def __init__(self, solver: ModuleType, job: Job, group: h5py.Group, report: int) -> None:
        self.solver, self.job, self.group, self.report = solver, job, group, report
        self.frames = 0
        self.seconds = 0.0
        self._steps = 0
        solids = self._solid_positions()
        self._box = job.closed_box(solids)
        # Corners of all particles that were seen, m.
        self._lower, self._upper = np.full(3, np.inf), np.full(3, -np.inf)
        position, velocity = self._fluid()
        self.position, self.velocity = create_frames(group, len(position))
        self._times: list[float] = []
        self._solver_seconds: list[float] = []
        self._solids: tuple[h5py.Dataset, h5py.Dataset] | None = None
        self._store_solids(np.concatenate([np.empty((0, 3), np.float32), *solids]))
        self._store(position, velocity)

    def step(self, seconds: float) -> None:
        """Record a step of the solver that took this wall time, s.

        Raises:
            EscapedError: a particle left the domain.
            RuntimeError: a particle is not finite, or the step has a different length.
        """
        self.seconds += seconds
        self._steps += 1
        self._correct_clock()
        if self._steps % self.job.steps_per_frame == 0:
            self._store(*self._fluid())

    def finish(self) -> None:
        """Write times, solver seconds and the scene's attributes, after the last frame."""
        self.group["time"] = np.array(self._times)
        self.group["solver_seconds"] = np.array(self._solver_seconds)
        self.job.attributes(*(self._box or (self._lower, self._upper))).write(self.group)

    def _correct_clock(self) -> None:
        # The clock is a sum of steps in single precision, which drifts by 2 % of a step over the
        # paper's 1,500 steps and by whole steps over more.
        clock, step = self.solver.TimeManager.getCurrent(), self.job.solver_step
        now, due = clock.getTime(), self._steps * step
        if abs(now - due) > 0.01 * step:
            raise RuntimeError(f"step {self._steps} ends at {due} s; the solver is at {now} s")
        clock.setTime(due)

    def _fluid(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        simulation = self.solver.Simulation.getCurrent()
        models = [*map(simulation.getFluidModel, range(simulation.numberOfFluidModels()))]

        def field(name: str) -> NDArray[np.float32]:
            # The buffers belong to the solver and have room for emitters: cut and copy.
            return np.concatenate(
                [np.array(it.getFieldBuffer(name))[: it.numActiveParticles()] for it in models]
            )

        position, velocity = field("position"), field("velocity")
        if hasattr(self, "position") and len(position) != self.position.shape[1]:
            raise RuntimeError(
                f"the number of particles changed from {self.position.shape[1]} to {len(position)}"
            )
        return position, velocity

    def _store(self, position: NDArray[np.float32], velocity: NDArray[np.float32]) -> None:
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            raise RuntimeError(f"a particle is not finite in frame {self.frames}")
        self._check_inside(position)
        self._widen(position)
        if self.job.solids_move:
            self._store_moving_solids()
        for dataset, values in ((self.position, position), (self.velocity, velocity)):
            dataset.resize(self.frames + 1, axis=0)
            dataset[self.frames] = values
        self._times.append(self.frames * self.job.steps_per_frame * self.job.solver_step)
        self._solver_seconds.append(self.seconds)
        self.seconds = 0.0
        self.frames += 1
        # A broken pipe stops this process: the one that started it is gone.
        os.write(self.report, b"frame\n")

    def _check_inside(self, position: NDArray[np.float32]) -> None:
        if self._box is None:
            return
        (lower, upper), radius = self._box, self.job.header.particle_radius
        outside = np.any((position < lower - radius) | (position > upper + radius), axis=1)
        if outside.any():
            raise EscapedError(
                f"{int(outside.sum())} of {len(position)} particles left through a wall "
                f"by frame {self.frames}"
            )

    def _widen(self, points: NDArray[np.float32]) -> None:
        """Widen the box of all particles to hold points (P, 3)."""
        if len(points):
            self._lower = np.minimum(self._lower, points.min(axis=0))
            self._upper = np.maximum(self._upper, points.max(axis=0))

    def _solid_positions(self) -> list[NDArray[np.float32]]:
        """Return the wall particles (M, 3) of each rigid body."""
        return [_rows(model.getPosition, model.numberOfParticles()) for model in self._bodies()]

    def _bodies(self) -> list[Any]:
        simulation = self.solver.Simulation.getCurrent()
        return [*map(simulation.getBoundaryModel, range(simulation.numberOfBoundaryModels()))]

    def _store_solids(self, solids: NDArray[np.float32]) -> None:
        self._widen(solids)
        if not self.job.solids_move:
            self.group.create_dataset("solid_position", data=solids, **COMPRESSION)
            return
        self._solids = create_frames(
            self.group, len(solids), names=("solid_position", "solid_velocity")
        )

    def _store_moving_solids(self) -> None:
        bodies = self._bodies()
        for dataset, name in zip(self._solids or (), ("getPosition", "getVelocity"), strict=True):
            rows = [_rows(getattr(model, name), model.numberOfParticles()) for model in bodies]
            values = np.concatenate([np.empty((0, 3), np.float32), *rows])
            dataset.resize(self.frames + 1, axis=0)
            dataset[self.frames] = values
            if name == "getPosition":
                self._widen(values)


def _rows(read: Callable[[int], Any], count: int) -> NDArray[np.float32]:
    """Return the vectors that a function of the row returns, (count, 3)."""
    return np.array([read(row) for row in range(count)], dtype=np.float32).reshape(-1, 3)
