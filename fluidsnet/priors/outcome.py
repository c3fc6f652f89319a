"""Outcome of the substeps of one neighbor search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from fluidsnet.neighbors.search import Neighbors
from fluidsnet.particles import Particles


@dataclass(frozen=True)
class Outcome:
    """State after the substeps of one search, and what they knew of it.

    Attributes:
        state: Particles after the substeps.
        pressures: (N,) m²/s each, of the phases of divergence and density.
        rates: (N,) 1/s each, of ρ/ρ₀ at the velocities before and after the substeps.
        density: (N,) ρ/ρ₀ in the middle of the last substep.
        surface: (N, 3) sum of V∇W there, 1/m.
        describe: Returns the fluid neighbors, and density, its gradient and the walls' moments at
            the new positions, (N, 14), see `density_and_walls`.
    """

    state: Particles
    pressures: tuple[Tensor, Tensor]
    rates: tuple[Tensor, Tensor]
    density: Tensor
    surface: Tensor
    describe: Callable[[], tuple[Neighbors, Tensor]]
