"""Description and background load of the machine that a study runs on."""

from __future__ import annotations

import os
import platform
import re
import time
from importlib import metadata
from pathlib import Path
from typing import Self, final

import psutil
import torch

from datamodules.generate.solver import solver_version
from fluidsnet.errors import UserError

#: Load of other processes, in cores, above which a timing is not trusted.
BUSY = 0.15

_PACKAGES = ("torch-cluster", "torch-scatter", "numba", "numpy", "lightning")


def cpu_model() -> str:
    """Return the name of the processor and the number of usable cores."""
    name = platform.processor() or platform.machine()
    if (info := Path("/proc/cpuinfo")).exists():
        found = re.search(r"^model name\s*: (.*)$", info.read_text(), re.MULTILINE)
        name = found.group(1) if found else name
    return f"{name}, {cores()} cores"


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def versions() -> str:
    """Return the versions of Python, of the packages that affect speed, and of the solver."""
    names = [f"Python {platform.python_version()}", f"torch {torch.__version__}"]
    names += [f"{package} {_version(package)}" for package in _PACKAGES]
    try:
        names.append(f"SPlisHSPlasH {solver_version()}")
    except UserError:
        names.append("SPlisHSPlasH not installed")
    return ", ".join(names)


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


@final
class OtherLoad:
    """Context manager that measures the load of other processes while its block runs.

    This process and its ended children do not count. On Linux the load includes the time that a
    host takes from a virtual machine.

    Attributes:
        cores: Mean number of cores that other processes kept busy, set after the block.
    """

    cores = 0.0

    def __enter__(self) -> Self:
        self._began, self._before = time.perf_counter(), _other_seconds()
        return self

    def __exit__(self, *_: object) -> None:
        elapsed = max(time.perf_counter() - self._began, 1e-3)
        self.cores = max(0.0, (_other_seconds() - self._before) / elapsed)


def _other_seconds() -> float:
    """Return the busy time of all cores since boot without that of this process, s."""
    times = psutil.cpu_times()._asdict()
    # User time includes that of guests.
    idle = sum(times.get(name, 0.0) for name in ("idle", "iowait", "guest", "guest_nice"))
    return float(sum(times.values()) - idle - sum(os.times()[:4]))
