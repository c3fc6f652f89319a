"""Samplers: the order of training, which a resumed run goes on in, and that of evaluation."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sized
from typing import Any, NamedTuple, cast, final

import torch
from lightning.pytorch.overrides.distributed import UnrepeatedDistributedSampler
from torch import distributed
from torch.utils.data import DistributedSampler

from fluidsnet.distributed import processes
from fluidsnet.errors import UserError
from fluidsnet.rng import derived_seed


class Draw(NamedTuple):
    """A sample of an epoch."""

    sample: int  # its index
    seed: int  # for its augmentation


@final
class TrainingOrder(DistributedSampler[Draw]):
    """Order of this process's training samples, another in each epoch.

    It depends on the seed and the epoch alone, and each sample has a seed of its own, so that
    neither validation, nor workers, nor an interruption changes what a run is trained on.

    Args:
        samples: Samples of all processes.
        epoch: Epoch of the first order.
        done: Samples of it that this process has had; the first order leaves them out.
    """

    def __init__(self, samples: Sized, epoch: int = 0, done: int = 0) -> None:
        count = processes()
        rank = distributed.get_rank() if count > 1 else 0
        # As Lightning seeds the samplers that it makes. Without a seed, one process takes its own.
        seed = os.environ.get("PL_GLOBAL_SEED", torch.initial_seed() if count == 1 else 0)
        super().__init__(cast(Any, samples), count, rank, seed=derived_seed(int(seed)))
        # Workers read ahead before Lightning says which epoch it is.
        self.set_epoch(epoch)
        self.done = done

    def __iter__(self) -> Iterator[Draw]:
        order = cast(Iterator[int], super().__iter__())
        done, self.done = self.done, 0
        for place, index in enumerate(order):
            if place >= done:
                yield Draw(index, derived_seed(self.seed, self.epoch, self.rank, place))


def progress_of(trainer: Any) -> tuple[int, int]:
    """Return the epoch that a resumed run begins with, and the batches of it that are done.

    Args:
        trainer: Lightning's trainer, or None.
    """
    if trainer is None or not trainer.fit_loop.restarting:
        return 0, 0
    epoch = trainer.fit_loop.epoch_progress.current.processed
    batches = trainer.fit_loop.epoch_loop.batch_progress
    # `processed` is counted before the hooks that save checkpoints, `completed` after them.
    return epoch, 0 if batches.is_last_batch else batches.current.processed


def each_once(dataset: Sized) -> UnrepeatedDistributedSampler | None:
    """Return a sampler that gives each item to exactly one process; None for one process.

    Lightning would repeat the first items until every process has as many, and count them twice.

    Raises:
        UserError: there are fewer items than processes.
    """
    if not (distributed.is_available() and distributed.is_initialized()):
        return None
    count = processes()
    if len(dataset) < count:
        raise UserError(
            f"There are {count} processes and only {len(dataset)} samples or simulations, "
            "and each process needs one; set trainer.devices to fewer."
        )
    return UnrepeatedDistributedSampler(dataset, shuffle=False)
