"""Work on frames in several processes, with results in the order of the frames."""

from __future__ import annotations

import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import get_context
from typing import TypeVar

from fluidsnet.errors import UserError

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Iterator[Result]:
    """Yield the result for each item, in order; no more than two items a worker are in memory.

    Args:
        work: Function that a process can import.
        items: Items, which are read as they are needed.
        workers: Number of processes; with one, this process does the work.

    Raises:
        UserError: A process was killed.
    """
    if workers == 1:
        yield from map(work, items)
        return
    waiting: deque[Future[Result]] = deque()
    source = iter(items)
    # Forked threads of torch and HDF5 could hold locks.
    pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_ignore_interrupts)
    try:
        waiting.extend(pool.submit(work, item) for item in islice(source, 2 * workers))
        while waiting:
            yield waiting.popleft().result()
            waiting.extend(pool.submit(work, item) for item in islice(source, 1))
    except BrokenProcessPool as error:
        raise UserError(
            f"One of {workers} processes was killed, most likely for lack of memory; "
            "try fewer --workers."
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
