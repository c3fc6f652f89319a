"""Generate a data set: draw the scenes, run the solver on all cores, join the files."""

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

import h5py

from datamodules.generate.job import Job
from datamodules.generate.recipe import Recipe
from datamodules.generate.solver import load_solver
from datamodules.schema import SPLITS
from fluidsnet.errors import UserError
from fluidsnet.progress import Progress


@dataclass(frozen=True)
class Failure:
    """Name, seed and reason of a simulation that failed."""

    name: str
    seed: list[int]
    reason: str


class _Worker:
    """Running solver process."""

    def __init__(self, name: str, job: Job, folder: Path) -> None:
        self.name, self.job = name, job
        self.log = folder / f"{name}.log"
        job_file = folder / f"{name}.json"
        job_file.write_text(job.to_json())
        self.reports, write_end = os.pipe()
        # Threads that spin while they wait, the default, slow down a busy machine thirtyfold.
        openmp = {"OMP_NUM_THREADS": str(job.threads), "OMP_WAIT_POLICY": "passive"}
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "datamodules.generate.solver", job_file, str(write_end)],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                pass_fds=[write_end],
                env={**os.environ, **openmp},
            )
        os.close(write_end)
        self.frames = 0

    def failure(self) -> Failure:
        """Return the exit status and the last output of the process as a failure."""
        output = self.log.read_text(errors="replace").splitlines()
        lines = [line.strip() for line in output if line.strip()][-2:]
        status = self.process.returncode
        reason = f"killed by signal {-status}" if status < 0 else f"exit status {status}"
        return Failure(self.name, self.job.seed, ": ".join([reason, *lines]))


def generate(
    recipe: Recipe, root: Path, processes: int | None = None, threads: int = 1
) -> list[Failure]:
    """Write ``train.h5``, ``val.h5`` and ``test.h5`` to a folder.

    Complete simulations of an interrupted call are kept; only missing ones are run.

    Args:
        recipe: Settings of the data set.
        root: Folder of the data set.
        processes: Simulations at the same time; the number of cores by default.
        threads: Solver threads per simulation.

    Returns:
        The simulations that failed; they are not in the data set.

    Raises:
        UserError: processes or threads are below one, the solver is not installed,
            the folder holds another data set, there are fewer different scenes than
            simulations, or all simulations of a split failed.
    """
    if processes is None:
        processes = os.cpu_count() or 1
    for name, value in (("processes", processes), ("threads", threads)):
        if value < 1:
            raise UserError(f"--{name} is {value}; it must be at least 1.")
    load_solver()
    starts = recipe.starts()
    parts = root / "parts"
    _claim(root, recipe)
    wanted = {
        split: [parts / f"{split}-{number:05d}.h5" for number in range(getattr(recipe, split))]
        for split in SPLITS
    }
    waiting = deque(
        (output.stem, recipe.job(split, number, starts[split, number], output, threads))
        for split, outputs in wanted.items()
        if not (root / f"{split}.h5").exists()
        for number, output in enumerate(outputs)
        if not output.exists()
    )
    if not waiting and not parts.exists():
        return []
    parts.mkdir(exist_ok=True)
    _sweep(parts)
    total = sum(map(len, wanted.values())) * recipe.frames
    done = total - len(waiting) * recipe.frames
    with (
        tempfile.TemporaryDirectory(dir=parts) as scratch,
        Progress(total=total, initial=done, unit="frame", desc="simulating") as bar,
    ):
        failures = _run(waiting, Path(scratch), processes, bar)
    for split, outputs in wanted.items():
        _join(root / f"{split}.h5", [output for output in outputs if output.exists()], failures)
    shutil.rmtree(parts)
    return failures


def _sweep(parts: Path) -> None:
    """Remove scratch folders and partial files of a killed call; keep complete simulations."""
    for path in parts.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.suffix != ".h5":
            path.unlink()


def _claim(root: Path, recipe: Recipe) -> None:
    """Write the recipe to the folder, or check that it equals the one already there."""
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
                "choose another --root, or remove the folder."
            )
    elif any((root / f"{split}.h5").exists() for split in SPLITS):
        raise UserError(f"{root} already holds data without a recipe.json; choose another --root.")
    else:
        note.write_text(text)


def _run(
    waiting: deque[tuple[str, Job]], scratch: Path, processes: int, bar: Progress
) -> list[Failure]:
    """Run the jobs, at most `processes` at the same time, and update the bar for each frame."""
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
                        failures.append(failure := worker.failure())
                        bar.write(
                            f"{failure.name} (seed {failure.seed}) failed and is left out: "
                            f"{failure.reason}",
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
    """Copy complete simulations into one file, without decompressing them."""
    if target.exists():
        return
    if not sources:
        failed = [failure for failure in failures if failure.name.startswith(f"{target.stem}-")]
        if failed:
            raise UserError(
                f"{target} would be empty: each of its {len(failed)} simulations failed; "
                f"the first with {failed[0].reason}"
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
