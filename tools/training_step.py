"""Times a training step of the paper's network: forward, backward and Adam.

Run from another checkout's folder it times that one's code, so that two can be compared in one
run::

    PYTHONPATH=<checkout> .venv/bin/python tools/training_step.py data/demo Auto
"""

from __future__ import annotations

import statistics
import sys
import time
from itertools import islice
from pathlib import Path
from typing import Any

import torch

import fluidsnet.neighbors
from datamodules import SPHDataModule
from fluidsnet import FluidsNet

WARM_UP, STEPS = 4, 30


def main(root: Path, search: str) -> None:
    """Prints the median and the least time of a step, ms.

    Args:
        root: a data set with steps of 5 ms, such as the demo's.
        search: a class of `fluidsnet.neighbors`.
    """
    torch.manual_seed(0)
    data = SPHDataModule(root, voxel_size=1.5 / 18, stride=4, batch_size=2)
    batches = list(islice(data.train_dataloader(), 8))
    model: Any = FluidsNet(data.cells, neighbors=getattr(fluidsnet.neighbors, search)())
    model.learn_scale(data.statistics, data.time_step)
    # There is no Trainer that could log.
    model.log = lambda *_, **__: None
    optimizer = torch.optim.Adam(model.parameters(), lr=0.003)
    seconds = []
    for number in range(WARM_UP + STEPS):
        started = time.perf_counter()
        optimizer.zero_grad()
        model.training_step(batches[number % len(batches)], number).backward()
        optimizer.step()
        seconds.append(1000 * (time.perf_counter() - started))
    seconds = seconds[WARM_UP:]
    fluid = statistics.mean(len(batch.state) for batch in batches)
    print(
        f"{search}: median {statistics.median(seconds):.1f} ms, least {min(seconds):.1f} ms, "
        f"{fluid:.0f} fluid particles in 2 frames"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
