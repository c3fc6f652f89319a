"""`escaped`: how many particles left the domain."""

from __future__ import annotations

from typing import final

from torch import Tensor

from fluidsnet.metrics.rollout_metric import RolloutMetric
from fluidsnet.particles import Particles


@final
class Escaped(RolloutMetric):
    """Share of the particles more than a radius outside the domain after n steps."""

    names = ("escaped",)
    of_truth = True

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        return escaped(predicted)[None]


def escaped(particles: Particles) -> Tensor:
    """The share of fluid particles more than a radius outside the domain, (), float64.

    A particle that is nowhere (not finite) has escaped.
    """
    scene = particles.scene
    reach = scene.extent / 2 + scene.particle_radius
    center = (scene.domain_lower + scene.domain_upper) / 2
    inside = ((particles.position - center).abs() <= reach).all(dim=1)
    return 1 - inside.double().mean()
