"""Kill trainings at random moments and fill their disks; the second part of `make soak`.

A training on the tests' sample saves a checkpoint at each step. It is killed, and resumed, or its
folder is a file system of some hundred kilobytes. Afterward every checkpoint that is there must be
whole, and a training that ends says why in a sentence.
"""

from __future__ import annotations

import contextlib
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tools.processes import started

ROOT = Path(__file__).resolve().parents[1]
#: Longest time that a training may take, s.
LIMIT = 120.0
#: Steps of a training.
STEPS = 40

_CHECKPOINT = "lightning.pytorch.callbacks.ModelCheckpoint"
# The class's keys, on one line for the command line.
_CALLBACK = (
    f"[{{class_path: {_CHECKPOINT}, init_args: {{filename: last, every_n_train_steps: 1, "
    "enable_version_counter: false}}]"
)


def arguments(folder: Path) -> list[str]:
    """Return the arguments of a training in a folder, resumed where it has a checkpoint."""
    configs = ("trainer.yaml", "model/paper.yaml", "data/sample.yaml")
    resumed = (folder / "run" / "checkpoints" / "last.ckpt").exists()
    return [
        *("fit", *(f"--config={ROOT / 'configs' / name}" for name in configs)),
        f"--data.init_args.root={ROOT / 'tests' / 'data' / 'dam_break'}",
        *("--data.init_args.batch_size=2", "--data.init_args.sample_every=8"),
        *("--trainer.max_epochs=-1", f"--trainer.max_steps={STEPS}"),
        *("--trainer.limit_val_batches=1", "--trainer.enable_progress_bar=false"),
        *("--trainer.log_every_n_steps=1", f"--trainer.callbacks={_CALLBACK}"),
        f"--trainer.logger.init_args.save_dir={folder}",
        *("--trainer.logger.init_args.name=run", "--trainer.logger.init_args.version="),
        *(["--ckpt_path=last"] if resumed else []),
    ]


def damaged(folder: Path) -> list[Path]:
    """Return the checkpoints in a folder that cannot be read."""
    from fluidsnet.checkpoint_io import WholeCheckpoints
    from fluidsnet.errors import UserError

    found = []
    for path in folder.rglob("*.ckpt"):
        try:
            WholeCheckpoints().load_checkpoint(path)
        except UserError:
            found.append(path)
    return found


def outcome(folder: Path, log: Path, life: float | None = None) -> tuple[str, str]:
    """Train and return what became of it, and the end of what it said.

    Args:
        folder: Folder of the run.
        log: File for what it says.
        life: Time after which the process is killed, s; None for none.
    """
    with started(arguments(folder), log) as process:
        process.join(LIMIT if life is None else life)
        hung = process.is_alive()
    said = log.read_text(errors="replace") if log.exists() else ""
    last = said.strip().rpartition("\n")[2]
    if hung and life is None:
        return "hang", said[-2000:]
    if "Traceback" in said:
        return "traceback", said[-4000:]
    if broken := damaged(folder):
        return "silent", f"damaged: {broken[0].name}"
    if process.exitcode in (0, -9):
        return "harmless", last
    if process.exitcode == 1 and last.startswith("fluidsnet: "):
        return "refused", last
    return "crash", f"exit status {process.exitcode}: {last}"


@contextlib.contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[bool]:
    """Mount a small file system at a folder; yield False where only root may do that."""
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
    mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", str(folder)], check=False)


def soak_runs(seconds: float, seed: int) -> Counter[str]:
    """Kill and starve trainings; return how many had each outcome.

    The first is killed, the second has a small disk, the others have either.

    Args:
        seconds: Time after which no further training is started, but for the first two.
        seed: Seed of the moments and sizes.
    """
    counts: Counter[str] = Counter()
    draw, began = random.Random(seed), time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        log, run, small = scratch / "log.txt", scratch / "run", scratch / "small"
        tried = 0
        while tried < 2 or time.monotonic() - began < seconds:
            tried += 1
            if tried == 1 or (tried > 2 and draw.random() < 0.7):
                what = f"killed after {(life := draw.uniform(1.0, 12.0)):.1f} s"
                ended, said = outcome(run, log, life)
            else:
                size = draw.randrange(50, 1500)
                with small_disk(small, size) as mounted:
                    if not mounted:
                        continue
                    what = f"on a disk of {size} kB"
                    ended, said = outcome(small, log)
            counts[ended] += 1
            if ended not in ("refused", "harmless"):
                print(f"{ended}: a training {what}\n{said}", flush=True)
            elif draw.random() < 0.3:
                shutil.rmtree(run, ignore_errors=True)  # starts afresh
    sys.stdout.flush()
    return counts
