"""One simulation in one process: the only place that imports SPlisHSPlasH.

The solver's simulator is a singleton, so `datamodules.generate.dataset` starts this
module once a simulation, as ``python -m datamodules.generate.solver job.json FD``. It
writes one line to the file descriptor FD for each frame that is done, and imports
neither torch nor Lightning, since it starts often.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.generate.job import Job
from datamodules.generate.scene_file import AKINCI_2012, REGULAR_TRIANGLES, scene_file
from datamodules.schema import COMPRESSION, Header, create_frames
from fluidsnet.errors import UserError


class EscapedError(RuntimeError):
    """A particle left the domain, as it can in the solver too."""


def load_solver() -> ModuleType:
    """Imports pysplishsplash.

    Its extension crashes where the system's libGL is loaded after it, so libGL comes first.

    Raises:
        UserError: where the solver or the libGL it links to is not installed.
    """
    try:
        ctypes.CDLL("libGL.so.1", mode=ctypes.RTLD_GLOBAL)
    except OSError as error:
        raise UserError(
            "The solver needs the system library libGL.so.1, which is not installed; "
            "install it with your system's packages (Debian, Ubuntu: apt-get install libgl1)."
        ) from error
    try:
        import pysplishsplash
    except ImportError as error:
        raise UserError(
            "The solver SPlisHSPlasH cannot be loaded "
            f"({error}); install it with `pip install 'fluidsnet[solver]'`."
        ) from error
    module: ModuleType = pysplishsplash
    return module


def solver_version() -> str:
    """Version of the installed solver.

    Raises:
        UserError: where it is not installed.
    """
    try:
        return metadata.version("pysplishsplash")
    except metadata.PackageNotFoundError as error:
        raise UserError(
            "The solver SPlisHSPlasH is not installed; "
            "install it with `pip install 'fluidsnet[solver]'`."
        ) from error


class Recorder:
    """Writes the frames of a running simulation to a file as the solver reaches them.

    Args:
        solver: the module pysplishsplash, with a simulation initialised.
        job: what is simulated.
        group: of the simulation, in a file open for writing.
        report: a file descriptor that gets a line a frame.
    """

    def __init__(self, solver: ModuleType, job: Job, group: h5py.Group, report: int) -> None:
        self.solver, self.job, self.group, self.report = solver, job, group, report
        self.frames = 0
        self.seconds = 0.0
        self.failure: Exception | None = None
        self._steps = 0
        self._upper = np.array(job.domain)
        position, velocity = self._fluid()
        self.position, self.velocity = create_frames(group, len(position))
        self._times: list[float] = []
        self._solver_seconds: list[float] = []
        self._store(position, velocity)
        self._resumed = time.perf_counter()

    def step(self) -> None:
        """Called by the solver after each of its steps."""
        self.seconds += time.perf_counter() - self._resumed
        try:
            self._steps += 1
            self._keep_time()
            if self._steps == 1:
                self._store_solids()
            if self._steps % self.job.steps_per_frame == 0 and self.frames < self.job.frames:
                self._store(*self._fluid())
        except Exception as error:  # the solver's C++ would swallow it
            self.failure = error
            raise
        self._resumed = time.perf_counter()

    def finish(self) -> None:
        """Writes what is known only at the end.

        Raises:
            RuntimeError: the solver stopped before the last frame.
        """
        if self.failure is not None:
            raise self.failure
        if self.frames < self.job.frames:
            raise RuntimeError(f"the solver ended after {self.frames} of {self.job.frames} frames")
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
        """The walls' particles, which the solver makes only once it runs."""
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


def simulate(job: Job, report: int) -> None:
    """Runs a job and leaves its file under its name once it is whole.

    Args:
        job: what to simulate.
        report: a file descriptor that gets a line a frame.

    Raises:
        EscapedError: a particle left the domain.
        RuntimeError: the solver failed.
        UserError: the solver is not installed.
    """
    solver = load_solver()
    output = Path(job.output)
    partial = output.with_name(f"{output.name}.{os.getpid()}.tmp")
    try:
        with tempfile.TemporaryDirectory(prefix="fluidsnet-") as scratch:
            folder = Path(scratch)
            scene = folder / "scene.json"
            scene.write_text(json.dumps(scene_file(job, folder)))
            base = solver.Exec.SimulatorBase()
            # One step more than is stored, so that rounding cannot lose the last frame.
            steps = (job.frames - 1) * job.steps_per_frame + 1
            base.init(
                sceneFile=str(scene),
                useGui=False,
                initialPause=False,
                useCache=False,
                outputDir=str(folder),
                stopAt=steps * job.solver_step,
            )
            base.initSimulation()
            with h5py.File(partial, "w") as file:
                _header(job).write(file)
                group = file.create_group("00000")
                group.attrs["seed"] = json.dumps(job.seed)
                group.attrs["scene_parameters"] = json.dumps(
                    [body.describe() for body in job.bodies]
                )
                group.attrs["threads"] = job.threads
                recorder = Recorder(solver, job, group, report)
                base.setTimeStepCB(recorder.step)
                base.runSimulation()
                recorder.finish()
            base.cleanup()
        partial.replace(output)
    finally:
        partial.unlink(missing_ok=True)


def _header(job: Job) -> Header:
    return Header(
        scene=job.scene,
        solver=job.solver,
        solver_version=solver_version(),
        solver_parameters={
            **job.parameters,
            "timeStepSize": job.solver_step,
            "viscosity": job.viscosity,
            "boundaryHandlingMethod": AKINCI_2012,
            "samplingMode": REGULAR_TRIANGLES,
        },
        domain_lower=(0.0, 0.0, 0.0),
        domain_upper=job.domain,
        gravity=job.gravity,
        particle_radius=job.particle_radius,
        support_radius=4 * job.particle_radius,
        dt=job.steps_per_frame * job.solver_step,
        density0=job.density0,
        viscosity=job.viscosity,
    )


def main(arguments: list[str]) -> int:
    """Runs the job file named first, reporting to the descriptor named second."""
    job = Job.from_json(Path(arguments[0]).read_text())
    # Both are read when the solver's OpenMP library loads. Passive: threads that spin
    # while they wait slow a busy machine thirtyfold.
    os.environ["OMP_NUM_THREADS"] = str(job.threads)
    os.environ["OMP_WAIT_POLICY"] = "passive"
    try:
        simulate(job, int(arguments[1]))
    except BrokenPipeError:
        return 1
    except (UserError, EscapedError, RuntimeError) as error:
        print(f"{error}", file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
