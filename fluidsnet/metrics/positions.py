"""Metrics of the positions in a rollout, particle by particle or of the fluid as a whole."""

from __future__ import annotations

from typing import final

import torch
from torch import Tensor

from fluidsnet.metrics.base import RolloutMetric
from fluidsnet.metrics.velocities import mean_of_squares
from fluidsnet.particles import Particles
from fluidsnet.periodic import shortest


@final
class RolloutPositionError(RolloutMetric):
    """Mean Euclidean distance ‖x̂ - x‖ after n steps, mm and particle radii.

    After one and two steps it is n1 and n2 of Ummenhofer et al. 2020 (CConv).
    """

    knows_periodic = True
    names = ("position_error_mm", "position_error_radii")
    components = 2

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        error = distance_mm(predicted.position, true.position, true).mean()
        return torch.stack([error, error / (1000 * true.scene.particle_radius)])


@final
class MSEn(RolloutMetric):
    """Mean of (x̂ - x)² over the first n steps, particles and axes, m².

    As in Toshev et al. 2023 (LagrangeBench), but over fluid particles only.
    """

    knows_periodic = True
    names = ("mse_n_m2",)

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        axes = true.scene.dimension
        difference = shortest(predicted.position - true.position, true)
        return mean_of_squares(difference)[None] * (3 / axes)

    def finish(self, values: Tensor) -> Tensor:
        steps = torch.arange(1, values.shape[1] + 1, device=values.device)
        return values.cumsum(dim=1) / steps[:, None]


@final
class CenterOfMass(RolloutMetric):
    """Relative error of the fluid's center of mass over the first n steps.

    Σ‖ĉ - c‖ / Σ‖c - c₀‖ over steps 1 to n, with the center c and the center c₀ of the start. 0 is
    perfect; a fluid that stays at its start has 1. It is large where the true center hardly moves.
    """

    names = ("center_of_mass",)
    components = 2

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        center = _center(true)
        offsets = torch.stack([_center(predicted) - center, center - _center(start)])
        lengths: Tensor = torch.linalg.vector_norm(offsets, dim=1)
        return lengths

    def finish(self, values: Tensor) -> Tensor:
        error, moved = values.cumsum(dim=1).unbind(dim=2)
        return (error / moved.clamp_min(torch.finfo(values.dtype).tiny))[..., None]


@final
class Escaped(RolloutMetric):
    """Share of the particles more than a radius outside the domain after n steps."""

    knows_periodic = True
    names = ("escaped",)
    of_truth = True

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        return escaped(predicted)[None]


@final
class NonFinite(RolloutMetric):
    """Share of the rollouts that had a non-finite value within the first n steps."""

    knows_periodic = True
    names = ("non_finite",)

    def measure(self, predicted: Particles, true: Particles, start: Particles) -> Tensor:
        # 0 times a non-finite value is NaN, so one sum finds it.
        zero = (0 * predicted.position + 0 * predicted.velocity).sum()
        return zero.isnan()[None]

    def finish(self, values: Tensor) -> Tensor:
        return values.cummax(dim=1).values

    def compute(self) -> dict[str, Tensor]:
        """Return `non_finite`, and two results about the rollouts.

        `non_finite_step` (R,) is the first step of each rollout with a non-finite value, or inf;
        `simulations` (S,) is the number of simulations measured after each step.
        """
        broken = self.values[..., 0] > 0
        first = broken.int().argmax(dim=1) + 1.0
        return {
            **super().compute(),
            "non_finite_step": first.where(broken.any(dim=1), torch.inf),
            "simulations": self.measured_simulations(),
        }


def distance_mm(predicted: Tensor, true: Tensor, particles: Particles) -> Tensor:
    """Return the distance of each pair of rows, (N,) float64 mm, by the shortest way.

    Args:
        predicted: (N, 3) m.
        true: (N, 3) m.
        particles: State of the same scene.
    """
    # Subtracting in float32 loses no digits that the inputs have.
    difference = shortest(predicted - true, particles)
    distance: Tensor = torch.linalg.vector_norm(difference, dim=1, dtype=torch.float64)
    return 1000 * distance


def escaped(particles: Particles) -> Tensor:
    """Return the share of fluid particles more than a radius outside the domain, () float64.

    Particles at a position that is not finite count as escaped.
    """
    scene = particles.scene
    reach = scene.extent / 2 + scene.particle_radius
    center = (scene.domain_lower + scene.domain_upper) / 2
    reach, center = particles.per_particle(reach), particles.per_particle(center)
    inside = ((particles.position - center).abs() <= reach).all(dim=1)
    return 1 - inside.double().mean()


def _center(particles: Particles) -> Tensor:
    return particles.position.mean(dim=0, dtype=torch.float64)
