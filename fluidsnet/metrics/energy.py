"""Energies of a state, which need no truth."""

from __future__ import annotations

import torch
from torch import Tensor

from fluidsnet.particles import Particles


def kinetic_energy(state: Particles) -> Tensor:
    """Return the mean kinetic energy per mass, () float64 J/kg."""
    return state.velocity.double().square().sum(dim=1).mean() / 2


def potential_energy(state: Particles) -> Tensor:
    """Return the mean potential energy per mass, () float64 J/kg.

    It is zero at the corner of the domain that is lowest under the scene's gravity.
    """
    scene = state.scene
    gravity = scene.gravity.double()
    lowest = torch.where(gravity < 0, scene.domain_lower, scene.domain_upper)
    height = state.position.double() - state.per_particle(lowest)
    return -(height * state.per_particle(gravity)).sum(dim=1).mean()
