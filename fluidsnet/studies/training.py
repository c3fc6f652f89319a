"""Resumable training and test of one composition of configs, as child processes."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import final

import torch
import yaml

from fluidsnet.child_process import python_module
from fluidsnet.errors import UserError

#: File in a run's folder: arguments, hashes of the configs, finished stages.
NOTE = "study.json"
_LOCK = "study.lock"
STAGES = ("fit", "test")


@final
class Training:
    """Train and test one composition of configs; finished stages are not run again.

    An interrupted training resumes from its last validation, with a new order of batches.

    Args:
        folder: Folder of the run, with the logs `fit.log` and `test.log`.
        configs: Config files, in the order of composition.
        arguments: Further arguments of `fluidsnet fit`; the run's folder is set here.
        threads: Threads of each process.

    Raises:
        UserError: The folder holds another training, or weights without a note.
    """

    def __init__(
        self, folder: Path, configs: Sequence[Path], arguments: Sequence[str], threads: int
    ) -> None:
        self.folder = folder
        self._arguments = [*(f"--config={config}" for config in configs), *arguments]
        # These are all: a `base` counts in the first config only, and trainer.yaml has none.
        hashes = {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in configs}
        self._identity = {"arguments": self._arguments, "configs": hashes}
        # Without both limits concurrent trainings wait for each other's cores.
        limits = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), str(threads))
        self._environment = {**os.environ, **limits}
        self._note = folder / NOTE
        self._checkpoint = folder / "checkpoints" / "last.ckpt"
        self._done = self._read_note()
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False

    @property
    def done(self) -> bool:
        """True where all stages are finished."""
        return all(stage in self._done for stage in STAGES)

    def stop(self) -> None:
        """Terminate the stage that another thread runs, and start no further one."""
        self._stopped = True
        if self._process is not None:
            self._process.terminate()

    def run(self, stage: str) -> None:
        """Run a stage unless it is finished.

        Raises:
            UserError: The stage failed or was stopped, or another process uses the folder.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / _LOCK).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UserError(
                    f"{self.folder} is in use by another process that trains or tests; wait for "
                    "it to end, or end it."
                ) from error
            # Another process may have finished the stage before the lock was taken.
            self._done = self._read_note()
            if stage in self._done:
                return
            self._write_note()
            log = self.folder / f"{stage}.log"
            status = self._execute(stage, lock.fileno(), log)
            if status:
                reason = f"failed: {_last_message(log)} ({log})"
                if status < 0:
                    reason = f"was killed by signal {-status}, possibly for lack of memory."
                raise UserError(f"{stage} of {self.folder} {reason}")
            if stage == "fit":
                self._check_checkpoint()
            self._done.append(stage)
            self._write_note()

    def _execute(self, stage: str, lock: int, log: Path) -> int:
        """Run a stage in a child process and return its exit status."""
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [*python_module("fluidsnet.main"), *self._command(stage)],
                stdout=output,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=self._environment,
                # The child keeps the lock if it outlives this process.
                pass_fds=[lock],
            )
        if self._stopped:
            self._process.terminate()
        return self._process.wait()

    def _command(self, stage: str) -> list[str]:
        quiet = "--trainer.enable_progress_bar=false"
        if stage == "test":
            return ["test", f"--run={self.folder}", quiet]
        logger = {"save_dir": self.folder.parent, "name": self.folder.name, "version": ""}
        options = [f"--trainer.logger.init_args.{name}={value}" for name, value in logger.items()]
        resume = [f"--ckpt_path={self._checkpoint}"] if self._checkpoint.exists() else []
        return ["fit", *self._arguments, *options, quiet, *resume]

    def _check_checkpoint(self) -> None:
        """Check that the weights of the last step were saved, since these are tested."""
        start, cause = f"fit of {self.folder} saved", "weights are saved at validations, so"
        interval = "--trainer.val_check_interval"
        if not self._checkpoint.exists():
            raise UserError(f"{start} no weights: {cause} train for {interval} steps or more.")
        config = yaml.safe_load((self.folder / "config.yaml").read_text())
        # -1 where --trainer.max_epochs ends the training.
        steps: int = config["trainer"]["max_steps"]
        # Mapped, so that the weights are not read.
        saved = torch.load(self._checkpoint, mmap=True, weights_only=True)["global_step"]
        if saved < steps:
            raise UserError(
                f"{start} the weights of step {saved} of {steps}: {cause} --trainer.max_steps must "
                f"be a multiple of {interval}."
            )

    def _read_note(self) -> list[str]:
        """Return the finished stages; none where nothing was trained."""
        trained = self._checkpoint.exists()
        remedy = f"name another --output, or delete {self.folder}."
        if not self._note.exists():
            if not trained:
                return []
            problem = f"holds weights but no {NOTE}, so their training is unknown"
            raise UserError(f"{self.folder} {problem}; {remedy}")
        try:
            note = json.loads(self._note.read_text())
        except (OSError, ValueError):
            note = None
        if not isinstance(note, dict) or not isinstance(note.get("done"), list):
            raise UserError(f"{self._note} is damaged; {remedy}")
        if any(note.get(name) != value for name, value in self._identity.items()):
            if not note["done"] and not trained:
                # That training saved nothing, for example because of a mistyped option.
                return []
            raise UserError(f"{self.folder} was trained with other options or configs; {remedy}")
        return [stage for stage in STAGES if stage in note["done"]]

    def _write_note(self) -> None:
        """Write the note atomically."""
        partial = self._note.with_suffix(".partial")
        partial.write_text(json.dumps({**self._identity, "done": self._done}, indent=2))
        partial.replace(self._note)


def _last_message(log: Path) -> str:
    """Return the error of a process in one line, or the last line of its log."""
    text = log.read_text(errors="replace").strip()
    _, found, error = f"\n{text}".rpartition("\nfluidsnet: ")
    return " ".join(error.split()) if found else (text.splitlines() or ["no output"])[-1]
