"""Which process gets which samples."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from typing import Any, final

from torch import distributed
from torch.utils.data import DistributedSampler

from fluidsnet.errors import UserError


@final
class EachOnce(DistributedSampler[Any]):
    """Deals the samples out to the processes, in order: what is measured is measured once.

    Lightning's own sampler repeats the first samples until every process has as many, which
    would count them twice.

    Args:
        dataset: of which only the number of samples matters.

    Raises:
        UserError: there are fewer samples than processes.
    """

    def __init__(self, dataset: Sized) -> None:
        super().__init__(dataset, shuffle=False)  # type: ignore[arg-type]
        self.rows = range(self.rank, len(dataset), self.num_replicas)
        if len(dataset) < self.num_replicas:
            raise UserError(
                f"There are {self.num_replicas} processes for {len(dataset)} samples or "
                "simulations, and none may go without; set trainer.devices to fewer."
            )

    def __iter__(self) -> Iterator[int]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)


def each_once(dataset: Sized) -> EachOnce | None:
    """`EachOnce` where several processes share the work; None where there is one."""
    together = distributed.is_available() and distributed.is_initialized()
    return EachOnce(dataset) if together else None
