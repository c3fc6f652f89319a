"""Training loss."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import mse_loss

from fluidsnet.distributed import processes, sum_over_processes


def mean_square(output: Tensor, expected: Tensor) -> Tensor:
    """Return the mean squared error over the particles of all processes (paper, section 5.3).

    Processes have different numbers of particles and DDP averages their losses, so each returns
    its part of the sum divided by the mean number.

    Args:
        output: (N, width) network output of this process.
        expected: (N, width) encoded truth.
    """
    if processes() == 1:
        return mse_loss(output, expected)
    total = mse_loss(output, expected, reduction="sum")
    numbers = sum_over_processes(total.new_full((), output.numel()))
    return processes() * total / numbers
