"""Free memory and peak memory of a device."""

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
    """Return the free memory of a device, bytes.

    On the CPU it is the memory that Linux reports as available, or the rest of a container's
    limit if that is less. On other systems it is half of the installed memory.
    """
    if device.type == "cuda":
        free, _ = torch.cuda.mem_get_info(device)
        # The cache of torch's allocator is free, too.
        held = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
        return int(free) + held
    try:
        available = _kibibytes(Path("/proc/meminfo"), "MemAvailable")
    except OSError:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    try:
        limit = int((_GROUP / "memory.max").read_text())
        remaining = limit - int((_GROUP / "memory.current").read_text())
    except (OSError, ValueError):  # no container, or "max" for one without a limit
        return available
    return max(0, min(available, remaining))


def peak_bytes(device: torch.device) -> int:
    """Return the peak memory since the start or the last reset, bytes.

    On CUDA it is the memory that torch allocated, elsewhere the process's resident memory.
    """
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    return _highest()


@final
class PeakMemory:
    """Context manager that measures the peak memory of its block beyond the memory before it.

    On CUDA it is the memory that torch allocates, on Linux the process's resident memory, whose
    high-water mark is reset. Other systems cannot reset the mark; there it is its increase.

    Attributes:
        bytes: Peak memory, set after the block.

    Args:
        device: Device to measure.
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
            # The block would reuse freed memory that the process still holds, unmeasured.
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
    """Return the high-water mark of the process's resident memory, bytes."""
    try:
        return _kibibytes(_SELF / "status", "VmHWM")
    except OSError:
        # macOS counts bytes, other systems kibibytes.
        unit = 1 if sys.platform == "darwin" else 1024
        return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _kibibytes(file: Path, name: str) -> int:
    """Read an entry of a /proc file that is in kB; return bytes."""
    found = re.search(rf"^{name}:\s+(\d+) kB", file.read_text(), re.MULTILINE)
    if found is None:
        raise OSError(f"{file} has no entry {name}")
    return 1024 * int(found.group(1))
