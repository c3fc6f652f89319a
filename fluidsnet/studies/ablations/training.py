"""One training of a study, in processes of its own: fit, then test, each once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from fluidsnet.errors import UserError

#: What is to be run, and how long the stages that are done took, s.
NOTE = "study.json"


class Training:
    """Trains and tests one composition of configs; what was done before is not done again.

    A training that was interrupted goes on from its last checkpoint.

    Args:
        folder: of the run; its logs `fit.log` and `test.log` lie there.
        arguments: of `fluidsnet fit`, beside what names the folder.
        threads: of each process.

    Raises:
        UserError: the folder holds another training.
    """

    STAGES = ("fit", "test")

    def __init__(self, folder: Path, arguments: Sequence[str], threads: int) -> None:
        self.folder, self.arguments, self.threads = folder, list(arguments), threads
        self._note = folder / NOTE
        if self._note.exists():
            known = json.loads(self._note.read_text())
            if known["arguments"] != self.arguments:
                raise UserError(
                    f"{folder} was trained with other options; name another --output, or delete it."
                )
            self.seconds: dict[str, float] = known["seconds"]
        else:
            self.seconds = {}

    @property
    def done(self) -> bool:
        """All stages are."""
        return all(stage in self.seconds for stage in self.STAGES)

    def run(self, stage: str) -> None:
        """Runs a stage, unless it is done.

        Raises:
            UserError: it ended badly; its last words say why.
        """
        if stage in self.seconds:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        self._keep()
        begin = time.monotonic()
        log = self.folder / f"{stage}.log"
        with log.open("ab") as words:
            ended = subprocess.run(
                [sys.executable, "-m", "fluidsnet.main", *self._command(stage)],
                stdout=words,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=self._environment(),
                check=False,
            )
        if ended.returncode:
            said = log.read_text(errors="replace").strip().splitlines()[-1:] or ["no words"]
            raise UserError(f"{stage} of {self.folder} failed: {said[0]} ({log})")
        self.seconds[stage] = time.monotonic() - begin
        self._keep()

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
        last = self.folder / "checkpoints" / "last.ckpt"
        return [*words, f"--ckpt_path={last}"] if last.exists() else words

    def _environment(self) -> Mapping[str, str]:
        # Of both, or those of one wait for those of the other.
        threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), str(self.threads))
        return {**os.environ, **threads}

    def _keep(self) -> None:
        """Writes the note; whole, or not at all."""
        partial = self._note.with_suffix(".partial")
        partial.write_text(json.dumps({"arguments": self.arguments, "seconds": self.seconds}))
        partial.replace(self._note)
