"""Linear layer that computes in float32 under autocast."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor, nn


@final
class Float32Linear(nn.Linear):
    """Linear layer that ignores autocast, for positions, offsets and motion.

    bfloat16 has 8 significant bits: it rounds positions in a domain of 6 m to 12 mm, and
    velocities to 0.4 %, an error that a rollout accumulates.
    """

    def forward(self, rows: Tensor) -> Tensor:
        """Return (N, outputs) for rows (N, inputs), in the precision of the weights."""
        with torch.autocast(rows.device.type, enabled=False):
            return super().forward(rows.to(self.weight.dtype))


def float32_on_cpu(values: Tensor) -> torch.autocast:
    """Return a context without autocast on the CPU, for 3-D convolutions of these values.

    In bfloat16 their weight gradients were NaN on the CPU (torch 2.13).
    """
    device = values.device.type
    return torch.autocast(device, enabled=device != "cpu" and torch.is_autocast_enabled(device))
