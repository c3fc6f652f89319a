"""Recorder: checks and stores the frames of a running simulation."""

from __future__ import annotations

import os
from types import ModuleType

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
        radius = job.header.particle_radius
        self._lower = np.array(job.scene.domain_lower) - radius
        self._upper = np.array(job.scene.domain_upper) + radius
        position, velocity = self._fluid()
        self.position, self.velocity = create_frames(group, len(position))
        self._times: list[float] = []
        self._solver_seconds: list[float] = []
        self._store_solids()
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
        """Write times and solver seconds, after the last frame."""
        self.group["time"] = np.array(self._times)
        self.group["solver_seconds"] = np.array(self._solver_seconds)

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

        return field("position"), field("velocity")

    def _store(self, position: NDArray[np.float32], velocity: NDArray[np.float32]) -> None:
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            raise RuntimeError(f"a particle is not finite in frame {self.frames}")
        outside = np.any((position < self._lower) | (position > self._upper), axis=1)
        if outside.any():
            raise EscapedError(
                f"{int(outside.sum())} of {len(position)} particles left through a wall "
                f"by frame {self.frames}"
            )
        for dataset, values in ((self.position, position), (self.velocity, velocity)):
            dataset.resize(self.frames + 1, axis=0)
            dataset[self.frames] = values
        self._times.append(self.frames * self.job.steps_per_frame * self.job.solver_step)
        self._solver_seconds.append(self.seconds)
        self.seconds = 0.0
        self.frames += 1
        # A broken pipe stops this process: the one that started it is gone.
        os.write(self.report, b"frame\n")

    def _store_solids(self) -> None:
        simulation = self.solver.Simulation.getCurrent()
        models = map(simulation.getBoundaryModel, range(simulation.numberOfBoundaryModels()))
        points = [it.getPosition(row) for it in models for row in range(it.numberOfParticles())]
        solids = np.array(points, dtype=np.float32).reshape(-1, 3)
        self.group.create_dataset("solid_position", data=solids, **COMPRESSION)
