"""How much memory is free, and how much a piece of work takes at its peak."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import resource
import sys
from pathlib import Path
from types import TracebackType
from typing import Self, final

import torch

_GROUP = Path("/sys/fs/cgroup")
_SELF = Path("/proc/self")


def free_bytes(device: torch.device) -> int:
    """Bytes that can be had on a device now without taking them from anyone.

    On a CPU what Linux says is available, or what a container's limit leaves of it; elsewhere
    half of what is built in.
    """
    if device.type == "cuda":
        free, _ = torch.cuda.mem_get_info(device)
        # What torch holds back for itself can be had, too.
        held = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
        return int(free) + held
    try:
        available = _kibibytes(Path("/proc/meminfo"), "MemAvailable")
    except OSError:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    try:
        most = int((_GROUP / "memory.max").read_text())
        left = most - int((_GROUP / "memory.current").read_text())
    except (OSError, ValueError):  # no container, or one without a limit, which says "max"
        return available
    return max(0, min(available, left))


def peak_bytes(device: torch.device) -> int:
    """The most bytes taken at once so far, or since the mark was last set back.

    On CUDA what torch's allocator gave out, elsewhere the resident memory of the whole process.
    """
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    return _highest()


@final
class PeakMemory:
    """Measures the most memory that is taken at once while its block runs, beyond what was before.

    On CUDA it is what torch's allocator gave out, on Linux the resident memory of the whole
    process, whose high-water mark is set back; elsewhere the mark is never set back, and the
    figure is what the block raised it by.

    Attributes:
        bytes: after the block.

    Args:
        device: whose memory.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.bytes = 0

    def __enter__(self) -> Self:
        gc.collect()
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
            torch.cuda.reset_peak_memory_stats(self.device)
            self._before = torch.cuda.memory_allocated(self.device)
            return self
        if sys.platform == "linux":
            # What was freed and is still held would be taken again unseen.
            trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
            if trim is not None:
                trim(0)
        try:
            (_SELF / "clear_refs").write_text("5")
            self._before = _kibibytes(_SELF / "status", "VmRSS")
        except OSError:
            self._before = _highest()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
            self.bytes = torch.cuda.max_memory_allocated(self.device) - self._before
            return
        self.bytes = max(0, _highest() - self._before)


def _highest() -> int:
    """The most resident bytes this process has had since the mark was set back."""
    try:
        return _kibibytes(_SELF / "status", "VmHWM")
    except OSError:
        # macOS counts bytes, the others kibibytes.
        unit = 1 if sys.platform == "darwin" else 1024
        return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _kibibytes(file: Path, name: str) -> int:
    """The bytes that a file of /proc says in kB."""
    found = re.search(rf"^{name}:\s+(\d+) kB", file.read_text(), re.MULTILINE)
    if found is None:
        raise OSError(f"{file} does not say {name}")
    return 1024 * int(found.group(1))
