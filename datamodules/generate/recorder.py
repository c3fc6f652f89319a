"""The frames of a running simulation, checked and stored as the solver reaches them."""

from __future__ import annotations

import os
from types import ModuleType

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.generate.job import Job
from datamodules.schema import COMPRESSION, create_frames


class EscapedError(RuntimeError):
    """A particle left the domain, as it can in the solver too."""


class Recorder:
    """Writes the frames of a running simulation to a file as the solver reaches them.

    Args:
        solver: the solver's module, with a simulation that is ready to step.
        job: what is simulated.
        group: of the simulation, in a file open for writing.
        report: a file descriptor that gets a line a frame.
    """

    def __init__(self, solver: ModuleType, job: Job, group: h5py.Group, report: int) -> None:
        self.solver, self.job, self.group, self.report = solver, job, group, report
        self.frames = 0
        self.seconds = 0.0
        self._steps = 0
        self._upper = np.array(job.domain)
        position, velocity = self._fluid()
        self.position, self.velocity = create_frames(group, len(position))
        self._times: list[float] = []
        self._solver_seconds: list[float] = []
        self._store_solids()
        self._store(position, velocity)

    def step(self, seconds: float) -> None:
        """Takes note of a step that the solver has done.

        Args:
            seconds: that the solver took for it.

        Raises:
            EscapedError: a particle left the domain.
            RuntimeError: a particle is not finite, or the step has another length.
        """
        self.seconds += seconds
        self._steps += 1
        self._keep_time()
        if self._steps % self.job.steps_per_frame == 0:
            self._store(*self._fluid())

    def finish(self) -> None:
        """Writes what is known only at the end."""
        self.group["time"] = np.array(self._times)
        self.group["solver_seconds"] = np.array(self._solver_seconds)

    def _keep_time(self) -> None:
        """Checks the solver's clock, and sets it.

        The clock is the sum of its steps in single precision, which drifts by 2 % of a step
        over the paper's 1,500 and by whole steps over more.
        """
        clock, step = self.solver.TimeManager.getCurrent(), self.job.solver_step
        now, due = clock.getTime(), self._steps * step
        if abs(now - due) > 0.01 * step:
            raise RuntimeError(f"step {self._steps} ends at {due} s; the solver is at {now} s")
        clock.setTime(due)

    def _fluid(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        simulation = self.solver.Simulation.getCurrent()
        models = [
            simulation.getFluidModel(number) for number in range(simulation.numberOfFluidModels())
        ]
        # The buffers are the solver's own and have room for emitters: cut and copy.
        position, velocity = (
            np.concatenate(
                [
                    np.array(model.getFieldBuffer(name))[: model.numActiveParticles()]
                    for model in models
                ]
            )
            for name in ("position", "velocity")
        )
        return position, velocity

    def _store(self, position: NDArray[np.float32], velocity: NDArray[np.float32]) -> None:
        radius = self.job.particle_radius
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            raise RuntimeError(f"a particle is not finite in frame {self.frames}")
        outside = np.any((position < -radius) | (position > self._upper + radius), axis=1)
        if outside.any():
            raise EscapedError(
                f"{int(outside.sum())} of {len(position)} particles left through a wall "
                f"by frame {self.frames}"
            )
        self.position.resize(self.frames + 1, axis=0)
        self.velocity.resize(self.frames + 1, axis=0)
        self.position[self.frames] = position
        self.velocity[self.frames] = velocity
        self._times.append(self.frames * self.job.steps_per_frame * self.job.solver_step)
        self._solver_seconds.append(self.seconds)
        self.seconds = 0.0
        self.frames += 1
        # A broken pipe means that nobody waits for this simulation any more: stop.
        os.write(self.report, b"frame\n")

    def _store_solids(self) -> None:
        """The walls' particles."""
        simulation = self.solver.Simulation.getCurrent()
        points = [
            model.getPosition(row)
            for model in map(
                simulation.getBoundaryModel, range(simulation.numberOfBoundaryModels())
            )
            for row in range(model.numberOfParticles())
        ]
        self.group.create_dataset(
            "solid_position",
            data=np.array(points, dtype=np.float32).reshape(-1, 3),
            **COMPRESSION,
        )
