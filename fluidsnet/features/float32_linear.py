"""Linear layers that mixed precision leaves alone."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor, nn


@final
class Float32Linear(nn.Linear):
    """A linear layer for places and offsets, or for the motion: never in bfloat16 or half.

    bfloat16 has 8 bits: at the far end of a domain of 6 m its steps are 12 mm, and that of a
    velocity is 0.4 %, which a rollout adds up.
    """

    def forward(self, rows: Tensor) -> Tensor:
        """The rows (N, outputs) of rows (N, inputs), as precise as the weights."""
        with torch.autocast(rows.device.type, enabled=False):
            return super().forward(rows.to(self.weight.dtype))


def float32_on_cpu(values: Tensor) -> torch.autocast:
    """A context without mixed precision on the CPU, for 3-D convolutions of these values.

    There, with torch 2.13, those in bfloat16 gave their weights a gradient that is no number.
    """
    device = values.device.type
    return torch.autocast(device, enabled=device != "cpu" and torch.is_autocast_enabled(device))
