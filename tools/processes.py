"""The program in processes of its own that share one import of PyTorch and Lightning."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from pathlib import Path

from fluidsnet.main import main

# Preloaded once, and no thread of a parallel region is forked.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["fluidsnet.cli", "datamodules.sph"])


@contextmanager
def started(
    arguments: list[str], output: Path, first: Callable[[], None] | None = None
) -> Iterator[BaseProcess]:
    """Run `fluidsnet` with arguments, as a shell would in the foreground, to the end of the block.

    Args:
        arguments: Command and options.
        output: File for what it prints to both streams.
        first: Called in the process before the command.
    """
    process = PROCESSES.Process(target=_run, args=(arguments, output, first))
    process.start()
    try:
        yield process
    finally:
        process.kill()
        process.join()


def _run(arguments: list[str], output: Path, first: Callable[[], None] | None) -> None:
    with output.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # That of any other process, for the workers of a data loader.
    multiprocessing.set_start_method("fork", force=True)
    if first is not None:
        first()
    sys.argv[1:] = arguments
    main()
