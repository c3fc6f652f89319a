"""3 x 3 x 3 convolution over the cells of a sparse grid."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, final

import torch
from torch import Tensor, nn
from torch.autograd import Function
from torch.autograd.function import once_differentiable

# Cells whose neighbors are gathered at once: a few MB, which stay in the cache of a CPU.
_CELLS = 1024


@final
class SparseConvolution(nn.Module):
    """Convolution with kernel 3 over cells that exist; the others count as zeros.

    Computes in the precision of the weights, also under autocast: gradients sum over all cells.

    Args:
        inputs: Channels of the input.
        outputs: Channels of the output.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        # As of nn.Conv3d.
        bound = (27 * inputs) ** -0.5
        self.weight = nn.Parameter(torch.empty(27, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(outputs).uniform_(-bound, bound))

    def forward(self, rows: Tensor, neighbor: Tensor) -> Tensor:
        """Return the convolution (C, outputs).

        Args:
            rows: (C, inputs) channels of the cells.
            neighbor: (C, 27) neighbors, see `Level`.
        """
        with torch.autocast(rows.device.type, enabled=False):
            result: Tensor = _Convolve.apply(  # type: ignore[no-untyped-call]
                rows.to(self.weight.dtype), self.weight, self.bias, neighbor
            )
        return result


class _Convolve(Function):
    """Convolution that gathers neighbors chunk by chunk, in both passes.

    If cell a has b as its neighbor at one offset, b has a at the opposite offset. So the gradient
    of the rows is a convolution with the mirrored kernel: it gathers and sums in order on any
    device, where the backward pass of a gather would add to the same rows several times.
    """

    @staticmethod
    def forward(ctx: Any, rows: Tensor, weight: Tensor, bias: Tensor, neighbor: Tensor) -> Tensor:
        ctx.save_for_backward(rows, weight, neighbor)
        result = rows.new_empty(len(rows), len(bias))
        kernel = weight.flatten(0, 1)
        for cells, gathered in _gather(rows, neighbor):
            torch.addmm(bias, gathered, kernel, out=result[cells])
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        rows, weight, neighbor = ctx.saved_tensors
        kernel = weight.flip(0).transpose(1, 2).flatten(0, 1)
        of_rows = torch.empty_like(rows)
        of_kernel = rows.new_zeros(rows.shape[1], len(kernel))
        for cells, gathered in _gather(gradient, neighbor):
            torch.mm(gathered, kernel, out=of_rows[cells])
            of_kernel.addmm_(rows[cells].T, gathered)
        of_weight = of_kernel.unflatten(1, (27, -1)).transpose(0, 1).flip(0)
        return of_rows, of_weight, gradient.sum(dim=0), None


def _gather(rows: Tensor, neighbor: Tensor) -> Iterator[tuple[slice, Tensor]]:
    """Yield slices of cells and the rows (n, 27 * channels) of their neighbors."""
    padded = nn.functional.pad(rows, (0, 0, 0, 1))
    for first in range(0, len(rows), _CELLS):
        cells = slice(first, first + _CELLS)
        near = neighbor[cells]
        yield cells, padded.index_select(0, near.flatten()).view(len(near), -1)
