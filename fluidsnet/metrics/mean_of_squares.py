"""The mean of squares that several metrics are made of."""

from __future__ import annotations

import torch
from torch import Tensor


def mean_of_squares(values: Tensor) -> Tensor:
    """Over all of them, (), float64: without a copy in float64, as a step of a rollout is short."""
    norm: Tensor = torch.linalg.vector_norm(values, dtype=torch.float64)
    return norm.square() / values.numel()
