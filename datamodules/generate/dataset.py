"""Makes a data set: draws the scenes, runs the solver on every core, joins the files."""

from __future__ import annotations

import json
import os
import selectors
import shutil
import subprocess
import sys
import tempfile
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import h5py
import numpy as np
from tqdm import tqdm

from datamodules.generate.job import Job, SolverName
from datamodules.generate.scene_file import PARAMETERS, SOLVER_STEPS
from datamodules.generate.scenes import Body, SceneKind, Vector
from datamodules.generate.solver import load_solver
from fluidsnet.errors import UserError

SPLITS = ("train", "val", "test")

#: So often a scene is drawn anew that another simulation has already.
_DRAWS = 1000


@dataclass(frozen=True)
class Recipe:
    """All that decides what a data set holds; one recipe and one seed, one data set.

    Attributes:
        scene: the kind of scene, which draws the fluid.
        particle_radius: m.
        train: number of simulations for training.
        val: number of simulations for validation.
        test: number of simulations for the test.
        frames: stored frames per simulation, the start included.
        frame_interval: time between stored frames, s; a whole number of solver steps.
        solver_step: the solver's fixed time step, s; 2.5 ms by default, 0.5 ms for WCSPH.
        solver: IISPH (the paper's), WCSPH, PCISPH or DFSPH.
        seed: every simulation draws its scene from this, its split and its own number.
        gravity: m/s².
        density0: rest density, kg/m³.
        viscosity: coefficient of the solver's standard viscosity.
        solver_parameters: of the pressure solver, as SPlisHSPlasH names them.
    """

    scene: SceneKind
    particle_radius: float
    train: int
    val: int
    test: int
    frames: int = 1500
    frame_interval: float = 0.0025
    solver_step: float | None = None
    solver: SolverName = "IISPH"
    seed: int = 0
    gravity: Vector = (0.0, -9.81, 0.0)
    density0: float = 1000.0
    viscosity: float = 0.01
    solver_parameters: dict[str, float] | None = None

    def __post_init__(self) -> None:
        if not self.step > 0:
            raise UserError(f"solver_step is {self.step}; it must be above zero.")
        ratio = self.frame_interval / self.step
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
            raise UserError(
                f"frame_interval ({self.frame_interval} s) must be a whole number of "
                f"solver steps ({self.step} s)."
            )
        if self.frames < 2:
            raise UserError(f"frames is {self.frames}; a simulation needs two at least.")

    @property
    def step(self) -> float:
        """The solver's time step, s: the recipe's, or the solver's own default."""
        return SOLVER_STEPS[self.solver] if self.solver_step is None else self.solver_step

    def starts(self) -> dict[tuple[str, int], list[Body]]:
        """What each simulation, by split and number, starts from; no two start alike.

        Coarse particles leave few blocks to choose from, and a simulation in two splits would
        make the test a test of memory.

        Raises:
            UserError: the kind of scene does not have that many different starts.
        """
        drawn: dict[tuple[str, int], list[Body]] = {}
        for split in SPLITS:
            for number in range(getattr(self, split)):
                random = np.random.default_rng(self.entropy(split, number))
                for _ in range(_DRAWS):
                    bodies = self.scene.sample(random, self.particle_radius)
                    if bodies not in drawn.values():
                        break
                else:
                    raise UserError(
                        f"{type(self.scene).__name__} draws no more than {len(drawn)} different "
                        "scenes; take smaller particles, wider ranges or fewer simulations."
                    )
                drawn[split, number] = bodies
        return drawn

    def entropy(self, split: str, number: int) -> list[int]:
        """The seed of a simulation."""
        return [self.seed, SPLITS.index(split), number]

    def job(self, split: str, number: int, bodies: list[Body], output: Path, threads: int) -> Job:
        """The simulation of this number in a split, from one of the `starts`."""
        return Job(
            output=str(output),
            scene=type(self.scene).__name__,
            solver=self.solver,
            domain=self.scene.domain,
            particle_radius=self.particle_radius,
            gravity=self.gravity,
            density0=self.density0,
            viscosity=self.viscosity,
            solver_step=self.step,
            steps_per_frame=round(self.frame_interval / self.step),
            frames=self.frames,
            seed=self.entropy(split, number),
            bodies=bodies,
            threads=threads,
            parameters={**PARAMETERS[self.solver], **(self.solver_parameters or {})},
        )


@dataclass(frozen=True)
class Failure:
    """A simulation that did not end well, and the solver's last words."""

    name: str
    seed: list[int]
    words: str


class _Worker:
    """A solver process that is under way."""

    def __init__(self, name: str, job: Job, folder: Path) -> None:
        self.name, self.job = name, job
        self.log = folder / f"{name}.log"
        job_file = folder / f"{name}.json"
        job_file.write_text(job.to_json())
        self.reports, write_end = os.pipe()
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": str(job.threads),
            "OMP_WAIT_POLICY": "passive",
        }
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "datamodules.generate.solver", job_file, str(write_end)],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                pass_fds=[write_end],
                env=environment,
            )
        os.close(write_end)
        self.frames = 0

    def last_words(self) -> str:
        """What the process printed last, on one line."""
        lines = [line.strip() for line in self.log.read_text(errors="replace").splitlines()]
        lines = [line for line in lines if line]
        status = self.process.returncode
        reason = f"killed by signal {-status}" if status < 0 else f"exit status {status}"
        return f"{reason}: {' / '.join(lines[-2:])}" if lines else reason


def generate(
    recipe: Recipe, root: Path, processes: int | None = None, threads: int = 1
) -> list[Failure]:
    """Makes ``train.h5``, ``val.h5`` and ``test.h5`` in a folder.

    Whole simulations of a call that was killed are kept; only what is missing is made.

    Args:
        recipe: what to make.
        root: the data set's folder.
        processes: simulations at once; as many as cores by default.
        threads: the solver's threads in each.

    Returns:
        The simulations that failed; they are not in the data set.

    Raises:
        UserError: the solver is not installed, the folder holds another data set,
            there are not as many different scenes as simulations, or a split would be
            empty because each of its simulations failed.
    """
    load_solver()
    starts = recipe.starts()
    parts = root / "parts"
    _claim(root, recipe)
    wanted = {
        split: [parts / f"{split}-{number:05d}.h5" for number in range(getattr(recipe, split))]
        for split in SPLITS
    }
    waiting: deque[tuple[str, Job]] = deque()
    done = 0
    for split, outputs in wanted.items():
        if (root / f"{split}.h5").exists():
            done += len(outputs)
            continue
        for number, output in enumerate(outputs):
            if output.exists():
                done += 1
            else:
                job = recipe.job(split, number, starts[split, number], output, threads)
                waiting.append((output.stem, job))
    if not waiting and not parts.exists():
        return []
    parts.mkdir(exist_ok=True)
    total = sum(len(outputs) for outputs in wanted.values()) * recipe.frames
    with (
        tempfile.TemporaryDirectory(prefix="fluidsnet-") as scratch,
        tqdm(total=total, initial=done * recipe.frames, unit="frame", desc="simulating") as bar,
    ):
        failures = _run(waiting, Path(scratch), processes or os.cpu_count() or 1, bar)
    for split, outputs in wanted.items():
        _join(root / f"{split}.h5", [output for output in outputs if output.exists()], failures)
    shutil.rmtree(parts)
    return failures


def _claim(root: Path, recipe: Recipe) -> None:
    """Notes the recipe in the folder, or checks that it is the one already noted."""
    note = root / "recipe.json"
    described = {
        **{name: value for name, value in vars(recipe).items() if name != "scene"},
        "scene": type(recipe.scene).__name__,
        **{f"scene.{name}": value for name, value in vars(recipe.scene).items()},
    }
    text = json.dumps(described, indent=2, default=str, sort_keys=True)
    root.mkdir(parents=True, exist_ok=True)
    if note.exists():
        if note.read_text() != text:
            raise UserError(
                f"{root} holds data of another recipe (see {note}); "
                "choose another --root, or remove that folder."
            )
    elif any((root / f"{split}.h5").exists() for split in SPLITS):
        raise UserError(f"{root} already holds data made in another way; choose another --root.")
    else:
        note.write_text(text)


def _run(
    waiting: deque[tuple[str, Job]], scratch: Path, processes: int, bar: tqdm[NoReturn]
) -> list[Failure]:
    """Runs the jobs, so many at once, and moves the bar by a frame for each frame."""
    failures: list[Failure] = []
    with selectors.DefaultSelector() as selector:
        running: list[_Worker] = []
        try:
            while waiting or running:
                while waiting and len(running) < processes:
                    worker = _Worker(*waiting.popleft(), scratch)
                    selector.register(worker.reports, selectors.EVENT_READ, worker)
                    running.append(worker)
                for key, _ in selector.select():
                    worker = key.data
                    lines = os.read(worker.reports, 65536)
                    if lines:
                        worker.frames += lines.count(b"\n")
                        bar.update(lines.count(b"\n"))
                        continue
                    selector.unregister(worker.reports)
                    os.close(worker.reports)
                    running.remove(worker)
                    worker.process.wait()
                    if worker.process.returncode != 0:
                        failure = Failure(worker.name, worker.job.seed, worker.last_words())
                        failures.append(failure)
                        bar.write(
                            f"{failure.name} (seed {failure.seed}) failed and is left out: "
                            f"{failure.words}",
                            file=sys.stderr,
                        )
                        bar.update(worker.job.frames - worker.frames)
        finally:
            for worker in running:
                worker.process.terminate()
            deadline = time.monotonic() + 5
            for worker in running:
                worker.process.wait(max(deadline - time.monotonic(), 0.1))
    return failures


def _join(target: Path, sources: list[Path], failures: list[Failure]) -> None:
    """Moves whole simulations into one file; chunks are copied as they lie, compressed."""
    if target.exists():
        return
    if not sources:
        lost = [failure for failure in failures if failure.name.startswith(f"{target.stem}-")]
        if lost:
            raise UserError(
                f"{target} would be empty: each of its {len(lost)} simulations failed; "
                f"the first said: {lost[0].words}"
            )
        return
    partial = target.with_suffix(".h5.tmp")
    with h5py.File(partial, "w") as file:
        for source in sources:
            with h5py.File(source, "r") as part:
                if not file.attrs:
                    for name, value in part.attrs.items():
                        file.attrs[name] = value
                number = source.stem.rpartition("-")[2]
                part.copy("00000", file, name=number)
    partial.replace(target)
