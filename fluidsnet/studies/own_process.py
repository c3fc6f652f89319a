"""A measurement in a fresh process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from fluidsnet.studies.trial import Result, Trial


def in_own_process(work: Path, trial: Trial) -> Result:
    """Measures in a fresh process, and waits for it.

    Args:
        work: folder for what goes to and fro.
        trial: what to measure.

    Returns:
        What was measured, or a failure: a process that ends badly takes nothing along.
    """
    task, answer = work / "trial.json", work / "result.json"
    answer.unlink(missing_ok=True)
    task.write_text(json.dumps(asdict(trial)))
    environment = {**os.environ, "OMP_NUM_THREADS": str(trial.threads)}
    log = work / "trial.log"
    with log.open("wb") as words:
        try:
            ended = subprocess.run(
                [sys.executable, "-m", "fluidsnet.studies.trial", str(task), str(answer)],
                stdout=words,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=environment,
                # What goes wrong beyond all expectation; a minute is for the start.
                timeout=3 * trial.seconds + 120,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Result(failure=f"skipped: beyond {trial.seconds:g} s")
    if ended.returncode < 0:
        return Result(failure=f"killed by signal {-ended.returncode}, as for lack of memory")
    if not answer.exists():
        last = log.read_text(errors="replace").strip().splitlines()[-1:] or ["no words"]
        return Result(failure=f"failed: {last[0]}")
    return Result(**json.loads(answer.read_text()))
