"""Columns that describe the state of `PressureStep` to a network."""

from __future__ import annotations

import torch
from torch import Tensor

#: Number of columns.
WIDTH = 22


def join_columns(
    described: Tensor,
    middle_density: Tensor,
    surface: Tensor,
    rates: tuple[Tensor, Tensor],
    pressures: tuple[Tensor, Tensor],
    time_step: float,
    radius: float,
) -> Tensor:
    """Return the columns (N, 22), without units and bounded.

    Density less 1, its gradient, ten moments of the walls, density less 1 in the middle of the
    last substep, sum of V∇W there, divergence before the step and left after it, and the two
    pressures.

    Args:
        described: (N, 14) density, gradient and moments at the next position.
        middle_density: (N,) ρ/ρ₀ in the middle of the last substep.
        surface: (N, 3) sum of V∇W there, 1/m.
        rates: (N,) each, of ρ/ρ₀ before and after the step, 1/s.
        pressures: (N,) each, of the phases of divergence and density, m²/s.
        time_step: s.
        radius: Support radius, m.
    """
    divergences = [(time_step * rate).clamp(-1, 1) for rate in rates]
    scale = 50 * time_step / radius**2
    return torch.cat(
        [
            (described[:, :1] - 1).clamp(-1, 1),
            described[:, 1:],
            torch.stack([(middle_density - 1).clamp(-1, 1), *divergences], dim=1),
            radius * surface,
            torch.stack([(scale * pressure).clamp(0, 20) for pressure in pressures], dim=1),
        ],
        dim=1,
    )
