"""Time a training step of the paper's network: forward, backward and Adam.

To time another checkout, run its copy of this script with its code::

    PYTHONPATH=<checkout> .venv/bin/python <checkout>/tools/training_step.py data/demo Auto
"""

from __future__ import annotations

import argparse
import inspect
import statistics
import sys
import time
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import torch

import fluidsnet.neighbors
from datamodules import SPHDataModule
from fluidsnet.errors import UserError
from fluidsnet.model import Model

WARM_UP, STEPS = 4, 30


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the arguments, and print the time of a step or what is wrong with the data set."""
    parser = argparse.ArgumentParser(description="Time a training step of the paper's network.")
    parser.add_argument("root", type=Path, help="a data set with steps of 5 ms, such as data/demo")
    parser.add_argument("search", choices=_searches(), help="neighbor search")
    options = parser.parse_args(arguments)
    try:
        measure(options.root, options.search)
    except UserError as error:
        sys.exit(f"{error}")


def measure(root: Path, search: str) -> None:
    """Print the median and the least time of a step, ms.

    Args:
        root: Data set with time steps of 5 ms, such as the demo's.
        search: Class name of the neighbor search.

    Raises:
        UserError: The data set cannot be used.
    """
    torch.manual_seed(0)
    data = SPHDataModule(root, voxel_size=1.5 / 18, stride=4, batch_size=2)
    batches = list(islice(data.train_dataloader(), 8))
    model = Model(data.grid_shape, neighbors=getattr(fluidsnet.neighbors, search)())
    model.set_statistics(data.statistics, data.time_step)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.003)
    seconds = []
    for index in range(WARM_UP + STEPS):
        started = time.perf_counter()
        optimizer.zero_grad()
        model.loss(batches[index % len(batches)]).backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        seconds.append(1000 * (time.perf_counter() - started))
    seconds = seconds[WARM_UP:]
    fluid = statistics.mean(len(batch.state) for batch in batches)
    print(
        f"{search}: median {statistics.median(seconds):.1f} ms, least {min(seconds):.1f} ms, "
        f"{fluid:.0f} fluid particles in 2 frames"
    )


def _searches() -> list[str]:
    """Return the class names of the neighbor searches."""
    return [
        name
        for name, kind in vars(fluidsnet.neighbors).items()
        if inspect.isclass(kind)
        and issubclass(kind, fluidsnet.neighbors.NeighborSearch)
        and not inspect.isabstract(kind)
    ]


if __name__ == "__main__":
    main()
