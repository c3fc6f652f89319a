"""Process of the solver for one job."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

from datamodules.generate.job import Job
from fluidsnet.child_process import python_module


def run_job(
    name: str,
    job: Job,
    scratch: Path,
    on_frame: Callable[[], object] = lambda: None,
    running: set[subprocess.Popen[bytes]] | None = None,
) -> str | None:
    """Run a job in a process of the solver; return the reason of a failure, None without one.

    Args:
        name: Name of the job's files in `scratch`.
        job: Settings of the simulation.
        scratch: Folder for the job's description and the solver's messages.
        on_frame: Called for each frame that is stored.
        running: Set that holds the process while it runs.
    """
    log, job_file = scratch / f"{name}.log", scratch / f"{name}.json"
    job_file.write_text(job.to_json())
    read_end, write_end = os.pipe()
    # Threads that spin while they wait, the default, slow down a busy machine thirtyfold.
    openmp = {"OMP_NUM_THREADS": str(job.threads), "OMP_WAIT_POLICY": "passive"}
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*python_module("datamodules.generate.solver"), job_file, str(write_end)],
            stdout=output,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            pass_fds=[write_end],
            env={**os.environ, **openmp},
        )
    running = set() if running is None else running
    running.add(process)
    os.close(write_end)
    with open(read_end) as reports:
        for _ in reports:
            on_frame()
    status = process.wait()
    running.discard(process)
    if status == 0:
        return None
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines()]
    reason = f"killed by signal {-status}" if status < 0 else f"exit status {status}"
    return ": ".join([reason, *list(filter(None, lines))[-2:]])
