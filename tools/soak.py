"""Try thousands of damaged data files, each in a process that may end; run by `make soak`.

Every file is the sample of the tests with one mutation, by bytes or by structure. It is opened,
read and stepped as `fluidsnet` does. What may not happen: a result that is not finite without a
word, a traceback, a hang, a crash. Trainings that are killed and disks that are full follow
(tools/soak_runs.py).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing as mp
import os
import random
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tools.soak_runs import soak_runs

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "tests" / "data" / "dam_break" / "val.h5"
#: Longest time that a file may take, s.
LIMIT = 20.0
#: What may not happen.
FAULTS = ("silent", "traceback", "hang", "crash")

Mutation = Callable[[Path, random.Random], str]

_VALUES: tuple[Any, ...] = (
    *(np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-300, 1e30, 1e300, 2**62, "text", b"\xff\xfe", ""),
    *([], [1.0], [1.0, 2.0], [0.0, -9.81, 0.0], [np.nan] * 3, [1e30] * 3, [[1.0] * 3] * 3, True),
)


def by_bytes(path: Path, draw: random.Random) -> str:
    """Change bytes of a file; return what was done."""
    content = bytearray(path.read_bytes())
    # Most of what breaks is in the first kilobytes, where groups and headers are.
    end = len(content) if draw.random() < 0.4 else min(len(content), 16_384)
    at = draw.randrange(end)
    kind = draw.choice(["flip", "random", "zero", "ones", "cut", "repeat"])
    length = draw.choice([1, 4, 8, 16, 64])
    if kind == "flip":
        content[at] ^= 1 << draw.randrange(8)
    elif kind == "random":
        content[at : at + length] = draw.randbytes(length)
    elif kind == "zero":
        content[at : at + length] = bytes(length)
    elif kind == "ones":
        content[at : at + length] = b"\xff" * length
    elif kind == "cut":
        del content[at:]
    else:
        content[at:at] = content[at : at + length]
    path.write_bytes(content)
    return f"{kind} {length} bytes at {at}"


def by_structure(path: Path, draw: random.Random) -> str:
    """Change an attribute, a data set or a group of a file; return what was done."""
    with h5py.File(path, "r+") as file:
        group = file[draw.choice(sorted(file))]
        kind = draw.choice(["attribute", "drop", "values", "shape", "type", "link", "extra"])
        if kind == "attribute":
            owner = draw.choice([file, group])
            name = draw.choice(sorted(owner.attrs))
            value = draw.choice(_VALUES)
            del owner.attrs[name]
            if draw.random() < 0.9:
                owner.attrs[name] = value
            return f"attribute {name} of {owner.name}: {value!r}"
        name = draw.choice(sorted(group))
        if kind == "drop":
            del group[name]
        elif kind == "values":
            data = group[name]
            index = tuple(draw.randrange(size) for size in data.shape)
            value = draw.choice([np.nan, np.inf, -1e30, 1e30, 1e38, 0.0])
            if draw.random() < 0.5:
                data[index] = value
            else:
                data[...] = value
            return f"values of {name}: {value}"
        elif kind == "shape":
            values = group[name][()]
            del group[name]
            changes = (values[:0], values[:1], values[..., :2], values.T, values.ravel())
            group[name] = changed = draw.choice(changes)
            return f"shape of {name}: {changed.shape}"
        elif kind == "type":
            values = group[name][()]
            kind = draw.choice([">f8", "f2", "i4", "u1", "S8", "bool", "c8"])
            del group[name]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                group[name] = np.nan_to_num(values).astype(kind)
            return f"type of {name}: {kind}"
        elif kind == "link":
            target = draw.choice(["/", f"/{group.name}", "/nowhere", group.name])
            del group[name]
            group[name] = draw.choice(
                [h5py.SoftLink(target), h5py.ExternalLink("/etc/passwd", target), file]
            )
        else:
            extra = draw.choice(["00007", "position", "😀", "a" * 300])
            if extra not in file:
                file.create_group(extra)
            return f"group {extra[:10]!r}"
    return f"{kind} {name}"


MUTATIONS: dict[str, Mutation] = {"bytes": by_bytes, "structure": by_structure}


def outcome_of(path: Path) -> str:
    """Open, read and step a file; return "refused", "harmless" or "silent"."""
    import torch

    import datamodules.guard
    from datamodules.inspection import summarize
    from datamodules.needs import grid_shape
    from datamodules.reader import FrameReader
    from fluidsnet import load
    from fluidsnet.errors import UserError

    datamodules.guard.LIMIT = 5.0
    try:
        reader = FrameReader(path)
        model = load("configs/model/prior.yaml")
        for name, frames in reader.frames.items():
            for frame in {0, frames // 2, frames - 1}:
                state = reader.state(name, frame, 1)
                grid_shape(state.scene, state.scene.support_radius)
            model.check_scenes(state.scene)
            with torch.no_grad():
                after = model.step(state)
            if not bool(after.position.isfinite().all() & after.velocity.isfinite().all()):
                return "silent"
        reader.close()
        summarize(path)
    except UserError as error:
        return "refused" if str(error).strip() else "silent"
    return "harmless"


def _work(connection: Connection) -> None:
    """Answer paths with outcomes until the other end closes."""
    os.environ["NUMBA_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115 — until the process ends
    warnings.simplefilter("ignore")
    with contextlib.suppress(EOFError, KeyboardInterrupt):
        while True:
            path = connection.recv()
            try:
                connection.send((outcome_of(Path(path)), ""))
            except Exception:
                connection.send(("traceback", traceback.format_exc()))


class Worker:
    """Process that tries files, and is started anew when it hangs or crashes."""

    def __init__(self) -> None:
        self._context = mp.get_context("spawn")
        self._start()

    def _start(self) -> None:
        self._ours, theirs = self._context.Pipe()
        self._process = self._context.Process(target=_work, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()

    def outcome(self, path: Path, limit: float = LIMIT) -> tuple[str, str]:
        """Return what became of a file, and the traceback if there was one."""
        self._ours.send(str(path))
        try:
            if self._ours.poll(limit):
                found: tuple[str, str] = self._ours.recv()
                return found
        except EOFError:
            self._process.join()
            status = self._process.exitcode
            self._start()
            return "crash", f"exit status {status}"
        self.close()
        self._start()
        return "hang", ""

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()


def soak(seconds: float, most: int, seed: int, keep: Path | None = None) -> Counter[str]:
    """Try mutated files and return how many had each outcome.

    Args:
        seconds: Time after which no further file is tried.
        most: Greatest number of files.
        seed: Seed of the mutations.
        keep: Folder for the files that were a fault, with a note of each.
    """
    counts: Counter[str] = Counter(dict.fromkeys(("refused", "harmless", *FAULTS), 0))
    draw, began, worker = random.Random(seed), time.monotonic(), Worker()
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "val.h5"
        shutil.copy(SAMPLE, path)
        # Compiles, and must be harmless.
        first, reason = worker.outcome(path, 300)
        if first != "harmless":
            raise SystemExit(f"the sample itself: {first} {reason}")
        while sum(counts.values()) < most and time.monotonic() - began < seconds:
            kind = draw.choice(sorted(MUTATIONS))
            shutil.copy(SAMPLE, path)
            try:
                what = MUTATIONS[kind](path, draw)
            except (OSError, RuntimeError, TypeError, ValueError):
                continue  # HDF5 itself cannot write that
            outcome, reason = worker.outcome(path)
            counts[outcome] += 1
            if outcome in FAULTS:
                print(f"{outcome}: {kind}, {what}\n{reason}", flush=True)
                if keep is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    shutil.copy(path, keep / f"{outcome}_{sum(counts.values())}.h5")
    worker.close()
    return counts


def main() -> None:
    """Run `make soak`; exit with status 1 if a fault was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--most", type=int, default=10**9, help="greatest number of files")
    parser.add_argument("--seed", type=int, default=random.randrange(10**6))
    parser.add_argument("--keep", type=Path, help="folder for the files that were a fault")
    options = parser.parse_args()
    print(f"seed {options.seed}", flush=True)
    # Three quarters of the time for files, the rest for trainings.
    counts = soak(0.75 * options.seconds, options.most, options.seed, options.keep)
    print(json.dumps({"files tried": sum(counts.values()), **counts}), flush=True)
    runs = soak_runs(0.25 * options.seconds, options.seed)
    print(json.dumps({"trainings tried": sum(runs.values()), **runs}))
    counts += runs
    sys.exit(any(counts[fault] for fault in FAULTS))


if __name__ == "__main__":
    main()
