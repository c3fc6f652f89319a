"""Small scenes of blocks in boxes, made without the solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import torch
from torch import Tensor

from fluidsnet.particles import Particles
from fluidsnet.scene import Scene

#: Distance of the surface of the fluid from the walls at the start, radii; nearer it is too dense.
CLEARANCE = 1.25
#: Gravity, m/s².
GRAVITY = (0.0, -9.81, 0.0)

Vector = tuple[float, float, float]


@final
@dataclass(frozen=True)
class Setting:
    """Resolution and time step of the scenes.

    Attributes:
        radius: Particle radius, m.
        time_step: s.
        viscosity: Coefficient of the solver.
    """

    radius: float
    time_step: float
    viscosity: float = 0.01

    def scene(self, layers: Sequence[int], gravity: Vector = GRAVITY) -> Scene:
        """Return a box in which so many layers of particles fit between the walls."""
        return Scene.single(
            (0.0, 0.0, 0.0),
            [2 * self.radius * (number + CLEARANCE) for number in layers],
            gravity,
            self.radius,
            4 * self.radius,
            self.time_step,
            viscosity=self.viscosity,
            name="stress",
        )

    def block(self, layers: Sequence[int], corner: Sequence[float] = (0, 0, 0)) -> Tensor:
        """Return a lattice of particles (N, 3), m; its corner in layers from that of the fluid."""
        axes = [torch.arange(number, dtype=torch.float64) for number in layers]
        lattice = torch.cartesian_prod(*axes) + torch.tensor(corner, dtype=torch.float64)
        return (self.radius * (CLEARANCE + 1 + 2 * lattice)).float()


def boxed(
    position: Tensor,
    scene: Scene,
    velocity: Vector = (0.0, 0.0, 0.0),
    walls: bool = True,
) -> Particles:
    """Return fluid of one velocity in a scene, with particles on the walls of its box.

    Args:
        position: (N, 3) m.
        scene: Scene of one frame.
        velocity: m/s.
        walls: Whether the walls have particles.
    """
    speed = torch.tensor([velocity]).expand(len(position), 3).clone()
    solids = wall_particles(scene) if walls else position.new_empty(0, 3)
    return Particles.single(position, speed, solids, scene)


def wall_particles(scene: Scene) -> Tensor:
    """Return particles (M, 3) on the walls of a box, a diameter apart, m."""
    lower, upper = scene.domain_lower[0].double(), scene.domain_upper[0].double()
    counts = ((upper - lower) / (2 * scene.particle_radius)).round().long().clamp_min(1).tolist()
    axes = [
        torch.linspace(float(low), float(high), count + 1, dtype=torch.float64)
        for low, high, count in zip(lower, upper, counts, strict=True)
    ]
    grid = torch.cartesian_prod(*axes)
    outer = ((grid == lower) | (grid == upper)).any(dim=1)
    return grid[outer].float()


def with_scene(state: Particles, **values: object) -> Particles:
    """Return a state in its scene with some of the values changed."""
    return replace(state, scene=replace(state.scene, **values))  # type: ignore[arg-type]


def scaled(state: Particles, factor: float, origin: float = 0.0) -> Particles:
    """Return a state in other units of length, at another place (that unit, on each axis).

    Args:
        state: State in m.
        factor: Length of a meter in the unit; speeds, gravity and viscosity follow.
        origin: Coordinate of the lower corner's former zero.
    """
    scene = state.scene
    x, y, z = scene.edges[0]
    lower, upper = factor * scene.domain_lower + origin, factor * scene.domain_upper + origin
    return replace(
        state,
        position=factor * state.position + origin,
        velocity=factor * state.velocity,
        solid_position=factor * state.solid_position + origin,
        scene=replace(
            scene,
            domain_lower=lower,
            domain_upper=upper,
            gravity=factor * scene.gravity,
            viscosity=factor**2 * scene.viscosity,
            particle_radius=factor * scene.particle_radius,
            support_radius=factor * scene.support_radius,
            edges=((factor * x, factor * y, factor * z),),
        ),
    )
