"""Options, tasks and results of the speed study, and the process that carries out a task."""

from __future__ import annotations

import os
import pickle
import re
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import h5py
import torch

from datamodules.generate.dataset import generate
from datamodules.generate.job import SolverName
from fluidsnet.child_process import python_code
from fluidsnet.errors import UserError
from fluidsnet.studies.dam_break import Dam
from fluidsnet.studies.machine import cores

Precision = Literal["float32", "bfloat16", "float16"]

#: Time for the start of a measuring process, s.
START = 120.0
# Code of the measuring process. `python -m` would import the module under a second name.
_MEASURE = "from fluidsnet.studies.speed.measure import main; main()"


@dataclass(frozen=True)
class SpeedOptions:
    """Options of the speed study.

    Attributes:
        particles: Numbers of fluid particles. For each, the study takes the dam break of whole
            particle layers that is nearest.
        threads: Threads of the network and of the solver; all cores by default.
        repeats: Number of timed steps of each measurement.
        neighbors: Neighbor searches of the network: Auto (stores no edges on the CPU),
            CellListCPU, CellList, TorchCluster.
        precision: float32, bfloat16, float16; the last two by autocast. The first two searches
            are measured in all of them, the other searches in the first only.
        compile: Measure the first two searches also with torch.compile, in float32.
        solvers: IISPH, DFSPH or none. The network steps states that the first one computed.
        frames: Frames that the solver computes after its start; their median is reported.
        time_step: Step of the network and interval between frames of the solver, s.
        solver_step: Time step of the solver, s; divides time_step.
        batch: Number of known frames predicted at once (Table 3 of the paper); 0 skips it.
        model: Config file of a network, such as configs/model/field.yaml, measured with random
            weights; the paper's network by default.
        run: Folder of a training run whose network is measured in place of model.
        device: Device of the network, cpu or cuda.
        seconds: Approximate time limit of a measurement, s. Sizes that would exceed it are
            skipped.
        output: Folder for speed.md, speed.csv and speed.png.
    """

    particles: list[int] = field(
        default_factory=lambda: [1000, 4000, 30000, 125000, 300000, 618043, 2000000]
    )
    threads: int = field(default_factory=cores)
    repeats: int = 7
    neighbors: list[Literal["Auto", "CellListCPU", "CellList", "TorchCluster"]] = field(
        default_factory=lambda: ["Auto", "TorchCluster", "CellList"]
    )
    precision: list[Precision] = field(default_factory=lambda: ["float32"])
    compile: bool = False
    solvers: list[Literal["IISPH", "DFSPH", "none"]] = field(
        default_factory=lambda: ["IISPH", "DFSPH"]
    )
    frames: int = 5
    time_step: float = 0.02
    solver_step: float = 0.004
    batch: int = 8
    model: str | None = None
    run: str | None = None
    device: str = "cpu"
    seconds: float = 120.0
    output: str = "runs/speed"

    def __post_init__(self) -> None:
        for name in ("repeats", "frames", "time_step", "solver_step", "seconds"):
            if not getattr(self, name) > 0:
                raise UserError(f"--{name} is {getattr(self, name)}; it must be above zero.")
        steps = self.time_step / self.solver_step
        if abs(steps - max(round(steps), 1)) > 1e-6:
            raise UserError(
                f"--time_step ({self.time_step} s) must be a whole number of solver steps "
                f"(--solver_step {self.solver_step} s)."
            )
        if min(self.particles, default=0) < 100:
            raise UserError("--particles takes numbers from 100 on, such as [1000,30000].")
        if not 1 <= self.threads <= cores():
            raise UserError(f"--threads is {self.threads}; this process can use {cores()} cores.")
        if self.batch < 0:
            raise UserError(f"--batch is {self.batch}; give a number of frames, or 0 for none.")
        if self.model is not None and self.run is not None:
            raise UserError("--model and --run both name a network; give only one of them.")
        if not self.neighbors or not self.precision:
            raise UserError("--neighbors and --precision need at least one name each.")
        devices = r"cpu|cuda(:\d+)?" if torch.cuda.is_available() else "cpu"
        if not re.fullmatch(devices, self.device):
            raise UserError(f"--device {self.device}: use cpu, or cuda if torch finds a GPU.")


@dataclass(frozen=True)
class Trial:
    """One measurement.

    Attributes:
        kind: `step` times a step, `reference` stores the velocities after a step in plain torch,
            `batch` times many frames predicted at once, `cores` measures the processor; the name
            of a solver times its frames.
        options: Network, device, threads, repeats and time limit.
        particles: Number of fluid particles.
        states: Data file; its last frame is the state, its last `options.batch` frames the batch.
        neighbors: Class name of the neighbor search.
        precision: float32, or the type of autocast.
        compile: Whether to use torch.compile.
    """

    kind: Literal["step", "reference", "batch", "cores"] | SolverName
    options: SpeedOptions
    particles: int = 0
    states: Path = Path()
    neighbors: str = "Auto"
    precision: Precision = "float32"
    compile: bool = False

    @property
    def reference(self) -> Path:
        """File of velocities that `reference` writes and `step` compares with."""
        return self.states.with_suffix(".npy")

    @property
    def label(self) -> str:
        """Name of the method with its settings, the same at all sizes."""
        if self.kind == "batch":
            return f"{self.options.batch} frames at once"
        if self.kind != "step":
            return self.kind
        compiled = ["torch.compile"] if self.compile else []
        return ", ".join([self.neighbors, self.precision, *compiled])

    @property
    def name(self) -> str:
        """Name of the measurement in messages."""
        if self.kind == "cores":
            return "the measurement of the cores"
        return f"{self.particles:,} particles, {self.label}"


@dataclass
class Result:
    """Outcome of a measurement; empty where nothing was measured.

    Attributes:
        step: Time of each repeat of a step, of all frames of a batch, or of a solver's frame, s.
        search: Time of each repeat of the neighbor search with stored edges, s.
        stages: Median time of each stage that the step has, s.
        peak: Peak memory of a step beyond the loaded model and state, bytes.
        error: Mean |Δv| against the reference, over the root mean square of its velocity.
        edges: Mean number of neighbors of a particle.
        batches: Number of frames in each batch.
        solver: Median time of a solver's frame beside a batch, s.
        solids: Number of wall particles.
        cores: Result of `measure_cores`.
        failure: Reason why the rest is empty.
        others: Mean number of cores that other processes kept busy meanwhile.
    """

    step: list[float] = field(default_factory=list)
    search: list[float] = field(default_factory=list)
    stages: dict[str, float] = field(default_factory=dict)
    peak: int | None = None
    error: float | None = None
    edges: float | None = None
    batches: list[int] = field(default_factory=list)
    solver: float | None = None
    solids: int = 0
    cores: dict[str, float] = field(default_factory=dict)
    failure: str = ""
    others: float = 0.0


def run_trial(trial: Trial) -> Result:
    """Measure in a fresh process; return a failure if it crashed or ran out of time.

    The peak memory of the process is that of the trial alone.
    """
    options = trial.options
    try:
        process = subprocess.run(
            python_code(_MEASURE),
            input=pickle.dumps(trial),
            capture_output=True,
            env={**os.environ, "OMP_NUM_THREADS": str(options.threads)},
            # Far beyond the trial's own limit.
            timeout=3 * options.seconds + START,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Result(failure=f"skipped: beyond {options.seconds:g} s")
    if process.returncode < 0:
        return Result(failure=f"killed by signal {-process.returncode}, as for lack of memory")
    if process.returncode > 0:
        lines = process.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
        return Result(failure=f"failed: {lines[-1]}")
    result: Result = pickle.loads(process.stdout)
    return result


def measure_solver(dam: Dam, solver: SolverName, frames: int, trial: Trial) -> Result:
    """Time the frames of a solver after the start; keep them as the trial's states if new."""
    options, folder = trial.options, trial.states.parent / solver
    recipe = dam.recipe(solver, frames, options.time_step, options.solver_step)
    try:
        generate(recipe, folder, processes=1, threads=options.threads)
        with h5py.File(folder / "train.h5") as file:
            group = next(iter(file.values()))
            seconds = group["solver_seconds"][1:].tolist()
            result = Result(step=seconds, solids=len(group["solid_position"]))
        if not trial.states.exists():
            (folder / "train.h5").rename(trial.states)
    except UserError as error:
        return Result(failure=f"failed: {error}")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return result
