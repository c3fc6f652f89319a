"""One training of the study, in processes of its own: fit, then test, each once."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import final

import torch
import yaml

from fluidsnet.errors import UserError

#: What is to be run, and which stages are done.
NOTE = "study.json"
_LOCK = "study.lock"


@final
class Training:
    """Trains and tests one composition of configs; what was done before is not done again.

    A training that was interrupted goes on from its last validation; its batches are drawn anew.

    Args:
        folder: of the run; its logs `fit.log` and `test.log` lie there.
        configs: files, in the order they are composed.
        arguments: more of `fluidsnet fit`, beside what names the folder.
        threads: of each process.

    Raises:
        UserError: the folder holds another training, or one that it does not say of what.
    """

    STAGES = ("fit", "test")

    def __init__(
        self, folder: Path, configs: Sequence[Path], arguments: Sequence[str], threads: int
    ) -> None:
        self.folder, self.threads = folder, threads
        self.arguments = [*(f"--config={config}" for config in configs), *arguments]
        self._what = {
            "arguments": self.arguments,
            # All that are read: a `base` would be the first one's, and trainer.yaml has none.
            "configs": {
                str(config): hashlib.sha256(config.read_bytes()).hexdigest() for config in configs
            },
        }
        self._note = folder / NOTE
        self._done = self._read()
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False

    @property
    def done(self) -> bool:
        """All stages are."""
        return all(stage in self._done for stage in self.STAGES)

    def stop(self) -> None:
        """Ends the stage that another thread runs, and lets none begin."""
        self._stopped = True
        if self._process is not None:
            self._process.terminate()

    def run(self, stage: str) -> None:
        """Runs a stage, unless it is done.

        Raises:
            UserError: it ended badly, and its last words say why; or another process runs it,
                or has run another training in the folder; or it was stopped.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        with self._alone() as lock:
            # Another process may have been here meanwhile.
            self._done = self._read()
            if stage in self._done:
                return
            self._keep()
            log = self.folder / f"{stage}.log"
            status = self._wait(stage, lock, log)
            if status < 0:
                raise UserError(
                    f"{stage} of {self.folder} was killed by signal {-status}, as for lack of "
                    "memory."
                )
            if status:
                raise UserError(f"{stage} of {self.folder} failed: {_last_words(log)} ({log})")
            if stage == "fit":
                self._check_checkpoint()
            self._done.append(stage)
            self._keep()

    def _wait(self, stage: str, lock: int, log: Path) -> int:
        """Runs a stage in a process of its own; the status that it ends with."""
        with log.open("wb") as words:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "fluidsnet.main", *self._command(stage)],
                stdout=words,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=self._environment(),
                # It holds the lock, too, should it outlive this process.
                pass_fds=[lock],
            )
        if self._stopped:
            self._process.terminate()
        return self._process.wait()

    def _command(self, stage: str) -> list[str]:
        if stage == "test":
            return ["test", f"--run={self.folder}", "--trainer.enable_progress_bar=false"]
        logger = "--trainer.logger.init_args"
        words = [
            "fit",
            *self.arguments,
            f"{logger}.save_dir={self.folder.parent}",
            f"{logger}.name={self.folder.name}",
            f"{logger}.version=",
            "--trainer.enable_progress_bar=false",
        ]
        last = self._checkpoint
        return [*words, f"--ckpt_path={last}"] if last.exists() else words

    @property
    def _checkpoint(self) -> Path:
        return self.folder / "checkpoints" / "last.ckpt"

    def _check_checkpoint(self) -> None:
        """The last weights are what is tested."""
        if not self._checkpoint.exists():
            raise UserError(
                f"fit of {self.folder} kept no weights: they are kept at validations, so it must "
                "train for at least --trainer.val_check_interval steps."
            )
        config = yaml.safe_load((self.folder / "config.yaml").read_text())
        # -1 where epochs say when it ends.
        steps: int = config["trainer"]["max_steps"]
        # Of this program's own making, and mapped: the weights are not read.
        found = torch.load(self._checkpoint, mmap=True, weights_only=False)["global_step"]
        if found < steps:
            raise UserError(
                f"fit of {self.folder} kept the weights of step {found} of {steps}: they are kept "
                "at validations, so --trainer.max_steps must be a multiple of "
                "--trainer.val_check_interval."
            )

    @contextmanager
    def _alone(self) -> Iterator[int]:
        """Holds the folder's lock, a file's descriptor."""
        with (self.folder / _LOCK).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UserError(
                    f"{self.folder} is being trained or tested by another process; wait for it, "
                    "or end it."
                ) from error
            yield lock.fileno()

    def _environment(self) -> Mapping[str, str]:
        # Of both, or those of one wait for those of the other.
        threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), str(self.threads))
        return {**os.environ, **threads}

    def _read(self) -> list[str]:
        """The stages that the note says are done; none where nothing was trained."""
        otherwise = "name another --output, or delete it."
        if not self._note.exists():
            if self._checkpoint.exists():
                raise UserError(
                    f"{self.folder} holds weights but no {NOTE}, which says of what training; "
                    f"{otherwise}"
                )
            return []
        try:
            known = json.loads(self._note.read_text())
        except (OSError, ValueError):
            known = None
        if not isinstance(known, dict) or not isinstance(known.get("done"), list):
            raise UserError(
                f"{self._note} is damaged; name another --output, or delete {self.folder}."
            )
        if any(known.get(name) != value for name, value in self._what.items()):
            if not known["done"] and not self._checkpoint.exists():
                # It never came to anything, as where an option was mistyped.
                return []
            raise UserError(f"{self.folder} was trained with other options or configs; {otherwise}")
        return [stage for stage in self.STAGES if stage in known["done"]]

    def _keep(self) -> None:
        """Writes the note; whole, or not at all."""
        partial = self._note.with_suffix(".partial")
        partial.write_text(json.dumps({**self._what, "done": self._done}, indent=2))
        partial.replace(self._note)


def _last_words(log: Path) -> str:
    """What a process said in the end: its error, in one line, or its last line."""
    words = log.read_text(errors="replace").strip()
    _, error, said = f"\n{words}".rpartition("\nfluidsnet: ")
    return " ".join(said.split()) if error else (words.splitlines() or ["no words"])[-1]
