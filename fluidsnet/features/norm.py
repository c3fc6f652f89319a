"""Batch norm over the rows of all DDP processes."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.distributed import processes, sum_over_processes


@final
class BatchNorm(nn.BatchNorm1d):
    """Batch norm over the rows of all processes, so that DDP trains as one process would.

    A SyncBatchNorm that also runs on CPUs. The variance takes a second pass over the rows, which
    is exact where the mean is large. A process may have no rows, but must call it as often as
    the others. Below two rows in all processes together, the running statistics are used.

    Args:
        width: Number of columns of the rows.
    """

    def __init__(self, width: int) -> None:
        super().__init__(width)

    def forward(self, rows: Tensor) -> Tensor:
        """Return the rows (N, width), normalized."""
        if self.training and processes() > 1:
            return self._shared(rows)
        if self.training and len(rows) < 2:
            return nn.functional.batch_norm(
                rows, self.running_mean, self.running_var, self.weight, self.bias, eps=self.eps
            )
        normalized: Tensor = super().forward(rows)
        return normalized

    def _shared(self, rows: Tensor) -> Tensor:
        assert self.running_mean is not None and self.running_var is not None
        assert self.momentum is not None and self.num_batches_tracked is not None
        values = rows.to(self.weight.dtype)
        own = torch.cat([values.sum(dim=0), values.new_full((1,), len(values))])
        sums = sum_over_processes(own)
        total, count = sums[:-1], sums[-1]
        # Selected on the device, since reading the count would make a GPU wait.
        enough = count > 1
        mean = torch.where(enough, total / count.clamp_min(1), self.running_mean)
        centered = values - mean
        squares = sum_over_processes(centered.square().sum(dim=0))
        variance = torch.where(enough, squares / count.clamp_min(1), self.running_var)
        with torch.no_grad():
            unbiased = variance * (count / (count - 1)).where(enough, 1)
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(unbiased, self.momentum)
            self.num_batches_tracked += 1
        return (centered * (variance + self.eps).rsqrt() * self.weight + self.bias).to(rows.dtype)
