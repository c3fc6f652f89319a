"""Process of one simulation; the only module that imports SPlisHSPlasH.

SPlisHSPlasH's simulator is a singleton, so `datamodules.generate.dataset` starts this
module once per simulation, as ``python -m datamodules.generate.solver job.json FD``. It
writes one line to the file descriptor FD per frame, and imports neither torch nor
Lightning, which would take longer than a short simulation.
"""

from __future__ import annotations

import ctypes
import json
import os
import runpy
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py

from datamodules.generate.job import DrawnJob, Job
from datamodules.generate.recorder import Recorder
from datamodules.generate.scene_file_job import SceneFileJob
from datamodules.schema import Header
from fluidsnet.errors import UserError

#: Simulated time that no simulation reaches, s.
_NEVER = 1e6
_MISSING = (
    "The solver SPlisHSPlasH cannot be loaded ({}); install it with "
    "`pip install 'fluidsnet[solver]'`."
)


def load_solver() -> ModuleType:
    """Import pysplishsplash.

    Raises:
        UserError: the solver or libGL is not installed.
    """
    try:
        # Before the solver, which crashes if libGL is loaded after it.
        ctypes.CDLL("libGL.so.1", mode=ctypes.RTLD_GLOBAL)
    except OSError as error:
        raise UserError(
            "The solver needs the system library libGL.so.1, which is not installed; "
            "install it with your system's packages (Debian, Ubuntu: apt-get install libgl1)."
        ) from error
    try:
        import pysplishsplash
    except ImportError as error:
        raise UserError(_MISSING.format(error)) from error
    module: ModuleType = pysplishsplash
    return module


def solver_version() -> str:
    """Return the version of the solver; raise a `UserError` if it is not installed."""
    try:
        return metadata.version("pysplishsplash")
    except metadata.PackageNotFoundError as error:
        raise UserError(_MISSING.format(error)) from error


def simulate(job: Job, report: int) -> None:
    """Run a job and write its file, which gets its name once it is complete.

    Args:
        job: Settings of the simulation.
        report: File descriptor that gets one line per frame.

    Raises:
        RuntimeError: the solver failed, or a particle left the domain.
    """
    solver = load_solver()
    # SPlisHSPlasH does not resolve paths from the working folder.
    output = Path(job.output).resolve()
    partial = output.with_name(f"{output.name}.{os.getpid()}.tmp")
    try:
        with tempfile.TemporaryDirectory(dir=output.parent) as scratch:
            folder = Path(scratch)
            base = start_solver(solver, job.solver_scene(folder), folder)
            with h5py.File(partial, "w") as file:
                _header(job).write(file)
                group = file.create_group("00000")
                job.write_notes(group)
                group.attrs["threads"] = job.threads
                recorder = Recorder(solver, job, group, report)
                run_script, move_solids = _script(job, solver, base), _mover(job, solver)
                while recorder.frames < job.frames:
                    run_script()
                    move_solids()
                    started = time.perf_counter()
                    if not base.timeStepNoGUI():
                        raise RuntimeError(
                            f"the solver ended after {recorder.frames} of {job.frames} frames"
                        )
                    recorder.step(time.perf_counter() - started)
                recorder.finish()
            base.cleanup()
        partial.replace(output)
    finally:
        partial.unlink(missing_ok=True)


def start_solver(solver: ModuleType, scene: dict[str, Any], folder: Path) -> Any:
    """Start the solver on a scene; return its simulator, which is a singleton.

    Args:
        solver: Module of the solver.
        scene: Scene in SPlisHSPlasH's format.
        folder: Folder that the solver may write to.
    """
    path = folder / "scene.json"
    path.write_text(json.dumps(scene))
    base = solver.Exec.SimulatorBase()
    options = dict.fromkeys(("useGui", "initialPause", "useCache"), False)
    base.init(sceneFile=str(path), outputDir=str(folder), stopAt=_NEVER, **options)
    base.initSimulation()
    # SPlisHSPlasH samples the walls in `runSimulation`. With its clock past the end it does that
    # and no step, so that each step can be timed.
    clock = solver.TimeManager.getCurrent()
    clock.setTime(2 * _NEVER)
    base.runSimulation()
    clock.setTime(0.0)
    return base


def _script(job: Job, solver: ModuleType, base: Any) -> Callable[[], None]:
    """Run the scene's script, which knows the solver as `splishsplash`; return its `step`."""
    if job.script is None:
        return lambda: None
    sys.modules["splishsplash"] = solver
    names = runpy.run_path(job.script)
    if "init" in names:
        names["init"](base)
    step: Callable[[], None] = names.get("step", lambda: None)
    return step


def _mover(job: Job, solver: ModuleType) -> Callable[[], None]:
    """Return a function that moves the job's solids over the step of the solver to come."""
    simulation, clock = solver.Simulation.getCurrent(), solver.TimeManager.getCurrent()
    first = simulation.numberOfBoundaryModels() - len(job.animated)
    bodies = [
        (simulation.getBoundaryModel(number).getRigidBodyObject(), solid)
        for number, solid in enumerate(job.animated, start=first)
    ]

    def move() -> None:
        time = clock.getTime()
        for body, solid in bodies:
            body.setVelocity(solid.velocity(time))
            body.setAngularVelocity(list(solid.spin))
            body.animate()

    return move


def _header(job: Job) -> Header:
    return replace(
        job.header, solver_version=solver_version(), solver_parameters=job.solver_parameters()
    )


def _read_job(path: Path) -> Job:
    values = json.loads(path.read_text())
    kinds: dict[str, type[Job]] = {kind.__name__: kind for kind in (DrawnJob, SceneFileJob)}
    return kinds[values.pop("kind")].from_values(values)


def main(arguments: list[str]) -> int:
    """Run a job: the arguments are its file and the file descriptor to report to."""
    job = _read_job(Path(arguments[0]))
    try:
        simulate(job, int(arguments[1]))
    except BrokenPipeError:  # the process that started this one is gone
        return 1
    except (UserError, RuntimeError) as error:
        print(error, file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
