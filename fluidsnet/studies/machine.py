"""Description and background load of the machine that a study runs on."""

from __future__ import annotations

import os
import platform
import re
import resource
import time
from importlib import metadata
from pathlib import Path
from typing import Self, final

import torch

from datamodules.generate.solver import solver_version
from fluidsnet.errors import UserError

#: Load of other processes, in cores, above which a timing is not trusted.
BUSY = 0.15

_PACKAGES = ("torch", "torch-cluster", "torch-scatter", "numba", "numpy", "lightning")


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


def device_name(device: str) -> str:
    """Return the name of a device."""
    if torch.device(device).type == "cuda":
        return torch.cuda.get_device_name(torch.device(device))
    return device


def versions() -> str:
    """Return the versions of Python, of the packages that affect speed, and of the solver."""
    names = [f"Python {platform.python_version()}"]
    for package in _PACKAGES:
        try:
            # The module's version includes the build, such as +cpu.
            version = torch.__version__ if package == "torch" else metadata.version(package)
        except metadata.PackageNotFoundError:
            version = "not installed"
        names.append(f"{package} {version}")
    try:
        names.append(f"SPlisHSPlasH {solver_version()}")
    except UserError:
        names.append("SPlisHSPlasH not installed")
    return ", ".join(names)


@final
class OtherLoad:
    """Context manager that measures the load of other processes while its block runs.

    This process and its children do not count. On Linux the load includes the time that a host
    takes from a virtual machine; elsewhere it is estimated from the load average.

    Attributes:
        cores: Mean number of cores that other processes kept busy, set after the block.
    """

    def __init__(self) -> None:
        self.cores = 0.0

    def __enter__(self) -> Self:
        self._began, self._all, self._own = time.perf_counter(), _all_seconds(), _own_seconds()
        return self

    def __exit__(self, *_: object) -> None:
        elapsed = max(time.perf_counter() - self._began, 1e-3)
        own = (_own_seconds() - self._own) / elapsed
        if self._all is None or (now := _all_seconds()) is None:
            self.cores = max(0.0, os.getloadavg()[0] - own)
            return
        self.cores = max(0.0, (now - self._all) / elapsed - own)


def _all_seconds() -> float | None:
    """Return the busy time of all cores since boot, s, with the time that a host took."""
    try:
        line = Path("/proc/stat").read_text().splitlines()[0]
    except OSError:
        return None
    user, nice, system, _idle, _wait, interrupt, soft, steal = map(int, line.split()[1:9])
    ticks = user + nice + system + interrupt + soft + steal
    return ticks / os.sysconf("SC_CLK_TCK")


def _own_seconds() -> float:
    """Return the CPU time of this process and its ended children, s."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)
