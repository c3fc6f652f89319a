"""A measurement of the speed study in a fresh process, whose peak memory is that of it alone."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import h5py

from datamodules.generate.dataset import generate
from datamodules.generate.recipe import Recipe
from fluidsnet.errors import UserError
from fluidsnet.studies.speed.options import Precision, SpeedOptions

#: Profiler ranges of a step, as `Network.forward` names them.
STAGES = ("sort", "search", "search + local", "local", "voxel", "global", "head")


@dataclass(frozen=True)
class Trial:
    """Task of a measuring process.

    Attributes:
        kind: `step` times a step, `reference` stores the velocities after a step in plain torch,
            `batch` times many frames predicted at once, `cores` measures the processor.
        options: Network, device, threads, repeats and time limit.
        states: Data file; its last frame is the state, its last `options.batch` frames the batch.
        neighbors: Class name of the neighbor search.
        precision: float32, or the type of autocast.
        compile: Whether to use torch.compile.
        reference: File of velocities that `reference` writes and `step` compares with.
    """

    kind: Literal["step", "reference", "batch", "cores"]
    options: SpeedOptions
    states: Path = Path()
    neighbors: str = "Auto"
    precision: Precision = "float32"
    compile: bool = False
    reference: Path = Path()


@dataclass(frozen=True)
class Result:
    """Outcome of a measurement; empty where nothing was measured.

    Attributes:
        step: Time of each repeat of a step, of all frames of a batch, or of a solver's frame, s.
        search: Time of each repeat of the neighbor search with stored edges, s.
        stages: Median time of each of `STAGES` that the step has, s.
        peak: Peak memory of a step beyond the loaded model and state, bytes.
        error: Mean |Δv| against the reference, over the root mean square of its velocity.
        edges: Mean number of neighbors of a particle.
        batches: Number of frames in each batch.
        solids: Number of wall particles.
        cores: Result of `measure_cores`.
        failure: Reason why the rest is empty.
    """

    step: list[float] = field(default_factory=list)
    search: list[float] = field(default_factory=list)
    stages: dict[str, float] = field(default_factory=dict)
    peak: int | None = None
    error: float | None = None
    edges: float | None = None
    batches: list[int] = field(default_factory=list)
    solids: int = 0
    cores: dict[str, float] = field(default_factory=dict)
    failure: str = ""


def run_trial(folder: Path, trial: Trial) -> Result:
    """Measure in a fresh process and wait for it.

    Args:
        folder: Folder for temporary files.
        trial: Task of the process.

    Returns:
        The result, or a failure where the process crashed or ran out of time.
    """
    task, answer, log = (folder / name for name in ("trial.pkl", "result.pkl", "trial.log"))
    answer.unlink(missing_ok=True)
    task.write_bytes(pickle.dumps(trial))
    seconds = trial.options.seconds
    with log.open("wb") as output:
        try:
            process = subprocess.run(
                [sys.executable, "-m", "fluidsnet.studies.speed.measure", task, answer],
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env={**os.environ, "OMP_NUM_THREADS": str(trial.options.threads)},
                # Far beyond the trial's own limit; two minutes for the start.
                timeout=3 * seconds + 120,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Result(failure=f"skipped: beyond {seconds:g} s")
    if process.returncode < 0:
        return Result(failure=f"killed by signal {-process.returncode}, as for lack of memory")
    if not answer.exists():
        last = log.read_text(errors="replace").strip().splitlines()[-1:] or ["no message"]
        return Result(failure=f"failed: {last[0]}")
    result: Result = pickle.loads(answer.read_bytes())
    return result


def measure_solver(recipe: Recipe, folder: Path, threads: int, states: Path) -> Result:
    """Time the frames of the solver.

    Args:
        recipe: Recipe of one simulation.
        folder: Folder for the solver's files, which are removed.
        threads: Threads of the solver.
        states: Where to keep the simulation, unless this file exists.
    """
    try:
        generate(recipe, folder, processes=1, threads=threads)
        path = folder / "train.h5"
        with h5py.File(path) as file:
            group = next(iter(file.values()))
            seconds = group["solver_seconds"][1:].tolist()
            result = Result(step=seconds, solids=len(group["solid_position"]))
        if not states.exists():
            path.rename(states)
    except UserError as error:
        return Result(failure=f"failed: {error}")
    finally:
        for path in folder.glob("*"):
            path.unlink()
    return result
