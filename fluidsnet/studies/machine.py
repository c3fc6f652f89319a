"""The machine a study runs on, and whether it is busy with something else."""

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

#: Cores' worth of other people's work above which a timing is not to be trusted.
BUSY = 0.15

_PACKAGES = ("torch", "torch-cluster", "torch-scatter", "numba", "numpy", "lightning")


def cpu_model() -> str:
    """The processor's name, and how many cores this process may use."""
    name = platform.processor() or platform.machine()
    if (info := Path("/proc/cpuinfo")).exists():
        found = re.search(r"^model name\s*: (.*)$", info.read_text(), re.MULTILINE)
        name = found.group(1) if found else name
    return f"{name}, {cores()} cores"


def cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def device_name(device: str) -> str:
    """What a device is called."""
    if torch.device(device).type == "cuda":
        return torch.cuda.get_device_name(torch.device(device))
    return device


def versions() -> str:
    """Python, and what decides how fast things are."""
    found = [f"Python {platform.python_version()}"]
    for package in _PACKAGES:
        try:
            # That of the module says what torch was built for.
            version = torch.__version__ if package == "torch" else metadata.version(package)
        except metadata.PackageNotFoundError:
            version = "not installed"
        found.append(f"{package} {version}")
    try:
        found.append(f"SPlisHSPlasH {solver_version()}")
    except UserError:
        found.append("SPlisHSPlasH not installed")
    return ", ".join(found)


@final
class OtherLoad:
    """Cores' worth of work that others do while a block runs, children of this process left out.

    Linux counts each core's time, and what a host takes from a virtual machine; elsewhere the
    load average less the children's own threads has to do.

    Attributes:
        cores: after the block.
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
    """S that all cores were busy since the start, with what a host took."""
    try:
        line = Path("/proc/stat").read_text().splitlines()[0]
    except OSError:
        return None
    user, nice, system, _idle, _wait, interrupt, soft, steal = map(int, line.split()[1:9])
    ticks = user + nice + system + interrupt + soft + steal
    return ticks / os.sysconf("SC_CLK_TCK")


def _own_seconds() -> float:
    """S of cores that this process and its ended children took."""
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in spent)
