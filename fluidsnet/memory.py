"""Free memory and peak memory of a device."""

from __future__ import annotations

import ctypes
import gc
import re
import resource
import sys
from pathlib import Path
from typing import Self, final

import psutil
import torch

_GROUP = Path("/sys/fs/cgroup")
_SELF = Path("/proc/self")


def free_bytes(device: torch.device) -> int:
    """Return the free memory of a device, bytes.

    On the CPU it is the memory that the system reports as available, or the rest of a container's
    limit if that is less.
    """
    if device.type == "cuda":
        free, _ = torch.cuda.mem_get_info(device)
        # The cache of torch's allocator is free, too.
        held = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
        return int(free) + held
    available: int = psutil.virtual_memory().available
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
    try:
        mark = re.search(r"^VmHWM:\s+(\d+) kB", (_SELF / "status").read_text(), re.MULTILINE)
    except OSError:
        mark = None
    if mark is not None:
        return 1024 * int(mark[1])
    # macOS counts bytes, other systems kibibytes.
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


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
        self.device, self.bytes = device, 0

    def __enter__(self) -> Self:
        gc.collect()
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
            torch.cuda.reset_peak_memory_stats(self.device)
            self._before = torch.cuda.memory_allocated(self.device)
            return self
        # The block would reuse freed memory that the process still holds, unmeasured.
        if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
            libc.malloc_trim(0)
        try:
            (_SELF / "clear_refs").write_text("5")
            self._before = psutil.Process().memory_info().rss
        except OSError:
            self._before = peak_bytes(self.device)
        return self

    def __exit__(self, *_: object) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.bytes = max(0, peak_bytes(self.device) - self._before)
