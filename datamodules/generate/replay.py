"""Process that lets SPlisHSPlasH continue true states, with a step and tolerance of one's choice.

The simulator is a singleton, so `replay` starts this module once per simulation, as ``python -m
datamodules.generate.replay job.json``. It writes a file for each state, so that what was computed
remains where the solver ends.
"""

from __future__ import annotations

import json
import math
import os
import re
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

from datamodules.generate.bodies import from_description
from datamodules.generate.job import PARAMETERS, DrawnJob, SolverName, scene_file
from datamodules.generate.particle_file import write_bgeo
from datamodules.generate.solver import load_solver, start_solver
from datamodules.schema import Header, SceneAttributes
from fluidsnet.child_process import python_module
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
        moved: Standard deviation of a normal noise on the positions of the starts, m.
        coarsen: Factor of the particle radius. Above 1 the solver samples the bodies of the scene
            anew, and all runs start at frame 0.
    """

    data: str
    simulation: str
    solver: SolverName
    solver_step: float
    tolerance: float | None
    threads: int
    runs: list[tuple[int, int]]
    moved: float = 0.0
    coarsen: float = 1.0

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
        setup: Wall time before the first step, s.
        memory: Most memory in use so far, without that of the solver's libraries, MB.
    """

    position: Array
    velocity: Array
    wall: float
    cpu: float
    setup: float
    memory: float


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
                [*python_module("datamodules.generate.replay"), folder / "job.json"],
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
                state = Replayed(values["position"], values["velocity"], *values["costs"].tolist())
            yield run, frame, state


def _continue(job: Replay, folder: Path) -> None:
    """Run a job in this process and write its states to a folder."""
    solver = load_solver()
    began, before = time.perf_counter(), _peak_memory()
    with h5py.File(job.data, "r") as file:
        group, header = file[job.simulation], Header.read(file)
        states: Any = (group["position"], group["velocity"])
        steps = max(round(header.dt / job.solver_step), 1)
        stride = max(round(job.solver_step / header.dt), 1)
        described = _scene(job, header, group, steps, folder)
        base = start_solver(solver, described, folder)
        setup = time.perf_counter() - began
        fluid = solver.Simulation.getCurrent().getFluidModel(0)
        for number, (first, frames) in enumerate(job.runs):
            if job.coarsen == 1:
                _put(fluid, states[0][first], states[1][first], job.moved)
            for frame in range(stride, frames + 1, stride):
                wall, cpu = time.perf_counter(), time.process_time()
                for _ in range(steps):
                    base.timeStepNoGUI()
                spent = time.perf_counter() - wall, time.process_time() - cpu
                costs = (*(it / stride for it in spent), setup, _peak_memory() - before)
                # Parts of buffers of the solver, which moves them.
                position, velocity = (
                    np.array(fluid.getFieldBuffer(name))[: fluid.numActiveParticles()]
                    for name in ("position", "velocity")
                )
                partial = folder / "partial"
                with partial.open("wb") as out:
                    np.savez(out, position=position, velocity=velocity, costs=costs)
                partial.rename(folder / f"{number:05}_{frame:05}.npz")
                if not np.isfinite(position).all():
                    break  # its search would fail


def _scene(
    job: Replay, header: Header, group: h5py.Group, steps: int, folder: Path
) -> dict[str, Any]:
    """Return the scene of a job in SPlisHSPlasH's format, and write the files that it needs."""
    coarse = job.coarsen != 1
    bodies = json.loads(group.attrs["scene_parameters"]) if coarse else []
    drawn = DrawnJob(
        output=str(folder / "unused.h5"),
        header=replace(
            header, solver=job.solver, particle_radius=job.coarsen * header.particle_radius
        ),
        solver_step=job.solver_step,
        steps_per_frame=steps,
        frames=1,
        threads=job.threads,
        scene=SceneAttributes.read(group),
        entropy=[],
        bodies=[*map(from_description, bodies)],
        parameters=job.parameters(),
    )
    described = scene_file(drawn, folder)
    if not coarse:
        particles = folder / "particles.bgeo"
        write_bgeo(particles, group["position"][job.runs[0][0]].astype(float))
        described["FluidModels"] = [{"particleFile": str(particles)}]
    return described


def _put(fluid: Any, position: Array, velocity: Array, moved: float) -> None:
    """Set the state of all particles, which keep their order, with noise on the places (m)."""
    noise = np.random.default_rng(0).normal(0.0, moved, position.shape) if moved else 0.0
    places = (position + noise).tolist()
    for row, (place, speed) in enumerate(zip(places, velocity.tolist(), strict=True)):
        fluid.setPosition(row, place)
        fluid.setVelocity(row, speed)


def _peak_memory() -> float:
    """Return the most memory that this process has used so far, MB; NaN where unknown."""
    # Not `resource`: there a child begins with the peak of its parent.
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return math.nan
    found = re.search(r"^VmHWM:\s+(\d+) kB", status, re.MULTILINE)
    return int(found[1]) / 1024 if found else math.nan


if __name__ == "__main__":
    path = Path(sys.argv[1])
    _continue(Replay(**json.loads(path.read_text())), path.parent)
