"""What training makes smaller."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import mse_loss

from fluidsnet.distributed import processes, sum_over_processes


def mean_square(output: Tensor, expected: Tensor) -> Tensor:
    """The mean squared error over the particles of all processes (paper, section 5.3).

    DDP averages what each process returns, and processes have different numbers of particles:
    each returns its part of the sum, over the mean number, so that the average is the mean.

    Args:
        output: (N, width) of this process.
        expected: (N, width) that would be right.
    """
    if processes() == 1:
        return mse_loss(output, expected)
    total = mse_loss(output, expected, reduction="sum")
    numbers = sum_over_processes(total.new_full((), output.numel()))
    return processes() * total / numbers
