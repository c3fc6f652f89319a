"""Generate a data set: draw the scenes, run the solver on all cores, join the files."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple, Protocol

import h5py

from datamodules.generate.job import Job
from datamodules.generate.process import run_job
from datamodules.generate.solver import load_solver
from datamodules.schema import SPLITS
from fluidsnet.disk_space import check_space
from fluidsnet.errors import UserError
from fluidsnet.folder_lock import FolderLock
from fluidsnet.progress import Progress
from fluidsnet.whole_file import whole_file, write_whole

#: Words in the messages of a process that ran out of disk.
_FULL = re.compile(r"No space left on device|File too large|[Ee]rrno(?: =)? (?:27|28)\b")


class Plan(Protocol):
    """Plan of a data set: its simulations and the jobs that make them.

    Attributes:
        frames: Stored frames per simulation.
        counts: Number of simulations of each split.
    """

    @property
    def frames(self) -> int: ...

    @property
    def counts(self) -> dict[str, int]: ...

    def description(self) -> str:
        """Return the plan as JSON text, by which its data set is recognized."""
        ...

    def jobs(self, folder: Path, threads: int) -> dict[str, Job]:
        """Return the job of each simulation by the name of its file in a folder."""
        ...


class Failure(NamedTuple):
    """Name, seed and reason of a simulation that failed."""

    name: str
    seed: list[int]
    reason: str


def generate(
    plan: Plan, root: Path, processes: int | None = None, threads: int = 1
) -> list[Failure]:
    """Write ``train.h5``, ``val.h5`` and ``test.h5`` to a folder.

    Complete simulations of an interrupted call are kept; only missing ones are run. Returns the
    simulations that failed; they are not in the data set.

    Args:
        plan: Simulations of the data set, such as a `Recipe`.
        root: Folder of the data set.
        processes: Simulations at the same time; the number of cores by default.
        threads: Solver threads per simulation.

    Raises:
        UserError: an option is below one, the solver is not installed, the folder holds another
            data set, there are too few different scenes, or all of a split failed.
    """
    if processes is None:
        processes = os.cpu_count() or 1
    for name, value in (("processes", processes), ("threads", threads)):
        if value < 1:
            raise UserError(f"--{name} is {value}; it must be at least 1.")
    load_solver()
    parts = root / "parts"
    jobs = plan.jobs(parts, threads)
    with FolderLock(root):
        return _generate(plan, root, jobs, processes)


def _generate(plan: Plan, root: Path, jobs: dict[str, Job], processes: int) -> list[Failure]:
    """Run the jobs whose results are missing, and join the files."""
    parts = root / "parts"
    _claim(root, plan.description())
    wanted = {
        split: [parts / f"{split}-{number:05d}.h5" for number in range(count)]
        for split, count in plan.counts.items()
    }
    waiting = {
        output.stem: jobs[output.stem]
        for split, outputs in wanted.items()
        if not (root / f"{split}.h5").exists()
        for output in outputs
        if not output.exists()
    }
    if not waiting and not parts.exists():
        return []
    parts.mkdir(exist_ok=True)
    # A killed call may have left scratch folders and partial files.
    for path in parts.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.suffix != ".h5":
            path.unlink()
    total = sum(map(len, wanted.values())) * plan.frames
    done = total - len(waiting) * plan.frames
    with (
        tempfile.TemporaryDirectory(dir=parts) as scratch,
        Progress(total=total, initial=done, unit="frame", desc="simulating") as bar,
    ):
        failures = _run(waiting, Path(scratch), processes, bar)
    for split, outputs in wanted.items():
        _join(root / f"{split}.h5", [output for output in outputs if output.exists()], failures)
    shutil.rmtree(parts)
    return failures


def _claim(root: Path, text: str) -> None:
    """Write a plan to the folder, or check that it equals the one already there."""
    note = root / "recipe.json"
    if note.exists():
        if note.read_text() != text:
            raise UserError(
                f"{root} holds data of another recipe (see {note}); "
                "choose another --root, or remove the folder."
            )
    elif any((root / f"{split}.h5").exists() for split in SPLITS):
        raise UserError(f"{root} already holds data without a recipe.json; choose another --root.")
    else:
        write_whole(note, text)


def _run(jobs: dict[str, Job], scratch: Path, processes: int, bar: Progress) -> list[Failure]:
    """Run the jobs, at most `processes` at the same time."""
    failures: list[Failure] = []
    running: set[subprocess.Popen[bytes]] = set()
    with ThreadPoolExecutor(processes) as pool:
        futures = [pool.submit(_simulate, *job, scratch, bar, running) for job in jobs.items()]
        try:
            for future in as_completed(futures):
                if failure := future.result():
                    if _FULL.search(failure.reason):
                        raise UserError(
                            f"{scratch.parent}: no space left on the disk; make room and repeat "
                            "the command: complete simulations are kept."
                        )
                    failures.append(failure)
                    bar.write(
                        f"{failure.name} (seed {failure.seed}) failed and is left out: "
                        f"{failure.reason}",
                        file=sys.stderr,
                    )
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in [*running]:
                process.terminate()
    return failures


def _simulate(
    name: str, job: Job, scratch: Path, bar: Progress, running: set[subprocess.Popen[bytes]]
) -> Failure | None:
    """Run a job in a process of the solver, and advance the bar for each frame."""
    frames = 0

    def advance() -> None:
        nonlocal frames
        frames += 1
        bar.update()

    reason = run_job(name, job, scratch, advance, running)
    if reason is None:
        return None
    bar.update(job.frames - frames)
    return Failure(name, job.seed, reason)


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
    kept = "; make room and repeat the command: complete simulations are kept"
    check_space(target, sum(source.stat().st_size for source in sources), kept)
    with whole_file(target) as partial, h5py.File(partial, "w") as file:
        for source in sources:
            with h5py.File(source, "r") as part:
                file.attrs.update(part.attrs)
                part.copy("00000", file, name=source.stem.rpartition("-")[2])
