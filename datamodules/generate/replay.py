"""Process that lets SPlisHSPlasH continue true states, with a step and tolerance of one's choice.

The simulator is a singleton, so `replay` starts this module once per simulation, as ``python -m
datamodules.generate.replay job.json``. It writes a file for each state, so that what was computed
remains where the solver ends.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, final

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.generate.job import PARAMETERS, DrawnJob, SolverName, scene_file
from datamodules.generate.particle_file import write_bgeo
from datamodules.generate.solver import load_solver, start_solver
from datamodules.schema import Header, SceneAttributes
from fluidsnet.errors import UserError

Array = NDArray[np.float32]


@final
@dataclass(frozen=True, kw_only=True)
class Replay:
    """True states to continue: each start frame for a few frames.

    Attributes:
        data: Data file of a scene that `fluidsnet generate` drew.
        simulation: Name of its group.
        solver: Pressure solver.
        solver_step: s; divides the frame interval or is a multiple of it.
        tolerance: Of density and divergence, per cent; none for WCSPH.
        threads: OpenMP threads.
        runs: Start frame and number of frames of each run.
    """

    data: str
    simulation: str
    solver: SolverName
    solver_step: float
    tolerance: float | None
    threads: int
    runs: list[tuple[int, int]]

    def parameters(self) -> dict[str, float]:
        """Return the solver's parameters under SPlisHSPlasH's names."""
        parameters = dict(PARAMETERS[self.solver])
        if self.tolerance is not None:
            parameters["maxError"] = self.tolerance
            if "maxErrorV" in parameters:
                # The data's own divergence is not solved for more closely than this.
                parameters["maxErrorV"] = max(self.tolerance, parameters["maxErrorV"])
        return parameters


@final
@dataclass(frozen=True)
class Replayed:
    """State that the solver made.

    Attributes:
        position: (N, 3) m.
        velocity: (N, 3) m/s.
        wall: Wall time of the solver steps of a frame, s.
        cpu: Time of all cores for them, s.
    """

    position: Array
    velocity: Array
    wall: float
    cpu: float


def replay(job: Replay, advance: Callable[[], None]) -> Iterator[tuple[int, int, Replayed]]:
    """Run a job in a process and yield the number of the run, that of the frame, and the state.

    Where the solver ends before its time, the states after that are missing.

    Args:
        job: What to continue.
        advance: Called now and then while the solver runs.

    Raises:
        UserError: The solver ended before its first state.
    """
    openmp = {"OMP_NUM_THREADS": str(job.threads), "OMP_WAIT_POLICY": "passive"}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "job.json").write_text(json.dumps(asdict(job)))
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "datamodules.generate.replay", folder / "job.json"],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env={**os.environ, **openmp},
            )
            try:
                while process.poll() is None:
                    time.sleep(0.05)
                    advance()
            finally:
                process.kill()
                process.wait()
        paths = sorted(folder.glob("*.npz"))
        if not paths:
            lines = (folder / "log").read_text(errors="replace").split("\n")
            reason = "; ".join(filter(None, lines[-3:])) or f"status {process.returncode}"
            raise UserError(
                f"{job.solver} at {1000 * job.solver_step:g} ms ended before its first state of "
                f"{job.data}: /{job.simulation}: {reason}"
            )
        for path in paths:
            run, frame = map(int, path.stem.split("_"))
            with np.load(path) as values:
                wall, cpu = values["seconds"].tolist()
                state = Replayed(values["position"], values["velocity"], wall, cpu)
            yield run, frame, state


def _continue(job: Replay, folder: Path) -> None:
    """Run a job in this process and write its states to a folder."""
    with h5py.File(job.data, "r") as file:
        group = file[job.simulation]
        header, scene = Header.read(file), SceneAttributes.read(group)
        states: Any = (group["position"], group["velocity"])
        steps = max(round(header.dt / job.solver_step), 1)
        stride = max(round(job.solver_step / header.dt), 1)
        drawn = DrawnJob(
            output=str(folder / "unused.h5"),
            header=replace(header, solver=job.solver),
            solver_step=job.solver_step,
            steps_per_frame=steps,
            frames=1,
            threads=job.threads,
            scene=scene,
            entropy=[],
            bodies=[],
            parameters=job.parameters(),
        )
        described = scene_file(drawn, folder)
        particles = folder / "particles.bgeo"
        write_bgeo(particles, states[0][job.runs[0][0]].astype(float))
        described["FluidModels"] = [{"particleFile": str(particles)}]
        solver = load_solver()
        base = start_solver(solver, described, folder)
        fluid = solver.Simulation.getCurrent().getFluidModel(0)
        for number, (first, frames) in enumerate(job.runs):
            _put(fluid, *(values[first] for values in states))
            for frame in range(stride, frames + 1, stride):
                wall, cpu = time.perf_counter(), time.process_time()
                for _ in range(steps):
                    base.timeStepNoGUI()
                spent = time.perf_counter() - wall, time.process_time() - cpu
                seconds = spent[0] / stride, spent[1] / stride
                # Parts of buffers of the solver, which moves them.
                position, velocity = (
                    np.array(fluid.getFieldBuffer(name))[: fluid.numActiveParticles()]
                    for name in ("position", "velocity")
                )
                partial = folder / "partial"
                with partial.open("wb") as out:
                    np.savez(out, position=position, velocity=velocity, seconds=seconds)
                partial.rename(folder / f"{number:05}_{frame:05}.npz")
                if not np.isfinite(position).all():
                    break  # its search would fail


def _put(fluid: Any, position: Array, velocity: Array) -> None:
    """Set the state of all particles; SPlisHSPlasH keeps their order."""
    for row, (place, speed) in enumerate(zip(position.tolist(), velocity.tolist(), strict=True)):
        fluid.setPosition(row, place)
        fluid.setVelocity(row, speed)


if __name__ == "__main__":
    path = Path(sys.argv[1])
    _continue(Replay(**json.loads(path.read_text())), path.parent)
