"""Share of the fluid's volume that is elsewhere, which needs no pairs of particles."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.base import RolloutMetric
from fluidsnet.particles import Particles

#: Edge of a cell, particle radii of the truth.
CELL = 8

# Cells along an axis that are told apart; farther ones count as the last.
_CELLS = 2**20


@final
class MisplacedVolume(RolloutMetric):
    """Share of the fluid's volume in other cells than the truth's after n steps.

    ½ Σ|V̂ - V| / ΣV over cells of eight particle radii, with the volume of each particle spread to
    the eight nearest cells by trilinear weights. 0 is perfect, and 1 has no volume in common. It
    compares fields, so that a fluid of other particles, larger ones too, has a value; one of
    twice the radius at the same place has some per cent.
    """

    names = ("misplaced_volume",)
    costly = True

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        cell = CELL * true.scene.particle_radius
        lower = true.scene.domain_lower[0]
        states = (predicted, true)
        shares = [_shares((it.position - lower) / cell, it.scene.dimension) for it in states]
        volumes = [it.scene.particle_volume / cell**it.scene.dimension for it in states]
        key = torch.cat([key.reshape(-1) for key, _ in shares])
        signed = [
            sign * volume * weight.reshape(-1)
            for sign, volume, (_, weight) in zip((1, -1), volumes, shares, strict=True)
        ]
        cells, index = torch.unique(key, return_inverse=True)
        differences = signed[0].new_zeros(len(cells)).index_add_(0, index, torch.cat(signed))
        misplaced = differences.abs().sum() / (2 * len(true) * volumes[1])
        return misplaced.where(predicted.position.isfinite().all(), torch.inf)[None]


def _shares(place: Tensor, dimension: int) -> tuple[Tensor, Tensor]:
    """Return keys (N, C) of the nearest cells and the weights (N, C), for places in cells."""
    place = place[:, :dimension].double() - 0.5
    place = place.nan_to_num(0.0, 0.0, 0.0).clamp(-_CELLS / 2 + 1, _CELLS / 2 - 2)
    corner = place.floor()
    share, corner = place - corner, corner.long() + _CELLS // 2
    key = corner.new_zeros(len(place), 1)
    weight = share.new_ones(len(place), 1)
    for axis in range(dimension):
        step = torch.stack([corner[:, axis], corner[:, axis] + 1], dim=1)
        part = torch.stack([1 - share[:, axis], share[:, axis]], dim=1)
        key = (key[:, :, None] * _CELLS + step[:, None]).flatten(1)
        weight = (weight[:, :, None] * part[:, None]).flatten(1)
    return key, weight
