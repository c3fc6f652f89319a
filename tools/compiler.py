"""Compiler that parses torch's headers once: `python compiler.py FOLDER JOBS COMMAND…`.

`tools/install.py` puts it in front of the C++ compiler, since every file of torch-scatter and
torch-cluster includes all headers of torch. The first file with a set of flags makes a precompiled
header of them, in FOLDER; the others wait for it. At most JOBS compilers run at once, whichever
package they serve. Where the header, or a file with it, does not compile, the file is compiled as
it would be without. Uses only the standard library.
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
def _one_of(folder: Path, jobs: int) -> Iterator[None]:
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


def _without_files(command: list[str]) -> list[str]:
    """Return the flags of a command that a header is compiled with as well."""
    flags, words = [], iter(command)
    for word in words:
        if word in ("-c", "-o"):
            next(words)
        elif not word.startswith(_NAME):
            flags.append(word)
    return flags


def _header(folder: Path, jobs: int, command: list[str]) -> Path | None:
    """Return the precompiled header for the flags of a command; None where it does not compile."""
    flags = _without_files(command)
    header = folder / f"torch-{hashlib.sha256(repr(flags).encode()).hexdigest()[:16]}.h"
    compiled, partial = header.with_suffix(".h.gch"), header.with_suffix(".partial")
    with _locked(header.with_suffix(".lock")):
        if not header.exists():
            header.write_text(_HEADERS)
            with _one_of(folder, jobs):
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
        folder: Folder of headers and locks.
        jobs: Maximum number of compilers at once.
        command: Compiler and arguments. With `-c` it compiles the C++ file that follows.
    """
    header = _header(folder, jobs, command) if "-c" in command else None
    with _one_of(folder, jobs):
        if header is not None:
            with_header = [*command, "-Winvalid-pch", "-include", str(header)]
            if subprocess.run(with_header).returncode == 0:
                return 0
            print("compiling without the precompiled header", flush=True)
        return subprocess.run(command).returncode


if __name__ == "__main__":
    sys.exit(compile_file(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
