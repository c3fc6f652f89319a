"""Compiler of torch-scatter and torch-cluster: `python compiler.py FOLDER JOBS COMMAND…`.

`tools/install.py` puts it in front of the C++ compiler, since every file of the two packages parses
all headers of torch:

- The first file with a set of flags makes a precompiled header in FOLDER; the others wait for it.
- An extension's two files, `csrc/knn.cpp` and `csrc/cpu/knn_cpu.cpp`, are compiled as one.
- At most JOBS compilers run at once, whichever package they serve.

The flags are the packages' own. Where the header, or a file with it, does not compile, the file is
compiled as it would be without. Uses only the standard library.
"""

from __future__ import annotations

import fcntl
import hashlib
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_HEADERS = "#include <Python.h>\n#include <torch/script.h>\n#include <torch/torch.h>\n"
# Differs from file to file, and no header of torch reads it.
_NAME = "-DTORCH_EXTENSION_NAME="


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def _job(folder: Path, jobs: int) -> Iterator[None]:
    """Wait until fewer than `jobs` compilers run."""
    while True:
        for number in range(jobs):
            with (folder / f"job-{number}").open("w") as file:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                yield
                return
        time.sleep(0.1)


def _hash(*values: object) -> str:
    return hashlib.sha256(repr(values).encode()).hexdigest()[:16]


def _flags(command: list[str]) -> list[str]:
    """Return compiler and flags of a command, without its files and the extension's name."""
    flags, words = [], iter(command)
    for word in words:
        if word in ("-c", "-o"):
            next(words)
        elif not word.startswith(_NAME):
            flags.append(word)
    return flags


def _header(folder: Path, jobs: int, command: list[str]) -> Path | None:
    """Return the header that is precompiled for a command; None where it does not compile."""
    flags = _flags(command)
    header = folder / f"torch-{_hash(flags)}.h"
    compiled, partial = header.with_suffix(".h.gch"), header.with_suffix(".partial")
    with _locked(header.with_suffix(".lock")):
        if not header.exists():
            header.write_text(_HEADERS)
            with _job(folder, jobs):
                made = subprocess.run([*flags, "-x", "c++-header", str(header), "-o", str(partial)])
            if made.returncode == 0:
                partial.rename(compiled)
            else:
                partial.unlink(missing_ok=True)
                print("no precompiled header, as above: compiling without it", flush=True)
    return header if compiled.exists() else None


def compile_file(folder: Path, jobs: int, command: list[str]) -> int:
    """Run the command of a compiler; return its exit status.

    Args:
        folder: Absolute path of the folder of headers and locks.
        jobs: Maximum number of compilers at once.
        command: Compiler and arguments; the C++ file to compile follows `-c`.
    """
    source = Path(command[command.index("-c") + 1]) if "-c" in command else None
    header = _header(folder, jobs, command) if source else None
    with _job(folder, jobs):
        if source is None or header is None:
            return subprocess.run(command).returncode
        # One mark for both files of an extension, which are compiled one after the other.
        second = source.parent / "cpu" / f"{source.stem}_cpu.cpp"
        part = source if source.parent.name == "cpu" else second
        mark = folder / f"compiled-{_hash(str(part.absolute()))}"
        if part == source and mark.exists():  # its code is in the other object
            word = command.index(str(source))
            command = [*command[:word], "-x", "c++", "/dev/null", *command[word + 1 :]]
            return subprocess.run(command).returncode
        joined = ["-include", str(second)] if second.exists() and not mark.exists() else []
        options = ["-Winvalid-pch", "-include", str(header), *joined]
        status = subprocess.run([*command, *options]).returncode
        if status == 0 and joined:
            mark.touch()
        elif status != 0:
            print("compiling without the precompiled header", flush=True)
            status = subprocess.run(command).returncode
        if part == source:
            mark.touch()
        return status


if __name__ == "__main__":
    sys.exit(compile_file(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
