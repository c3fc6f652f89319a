"""`center_of_mass`: whether a rollout's fluid goes as a whole where the truth goes."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class CenterOfMass(RolloutMetric):
    """Relative error of the fluid's center of mass over the first n steps.

    With c the center and c₀ that of the start, Σ‖ĉ - c‖ / Σ‖c - c₀‖ over steps 1 to n. 0 is
    perfect, and a fluid that stays where it started is off by 1; that of a fluid at rest,
    whose center goes nowhere, is off by far more.
    """

    names = ("center_of_mass",)
    components = 2

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        center = _center(true)
        offsets = torch.stack([_center(predicted) - center, center - _center(start)])
        lengths: Tensor = torch.linalg.vector_norm(offsets, dim=1)
        return lengths

    def finish(self, values: Tensor) -> Tensor:
        error, way = values.cumsum(dim=1).unbind(dim=2)
        return (error / way.clamp_min(torch.finfo(values.dtype).tiny))[..., None]


def _center(particles: Particles) -> Tensor:
    return particles.position.mean(dim=0, dtype=torch.float64)
