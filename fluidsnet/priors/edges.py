"""SPH sums over the edges of a step in plain torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import torch
from torch import Tensor

from fluidsnet.kernels.sph_sums import REGULARIZATION
from fluidsnet.moments import moment_weights
from fluidsnet.neighbors.search import Neighbors
from fluidsnet.particles import Particles
from fluidsnet.sph import cubic_spline, spline_height, spline_slope


@final
@dataclass(frozen=True)
class Edges:
    """Edges of a step, and what does not change in it.

    Attributes:
        particle: (E,) fluid particle of each edge.
        neighbor: (E,) fluid particle, or of an edge to a solid 0.
        wet: (E,) whether the neighbor is fluid.
        place: (E, 3) of the solid neighbor in the middle of the substeps, m.
        speed: (E, 3) of the solid neighbor, m/s; None where solids rest.
        volume: (E,) of the neighbor, m³.
        own_volume: Of a fluid particle, m³.
        radius: Support radius, m.
        dimension: 2 or 3.
        count: Number of fluid particles.
    """

    particle: Tensor
    neighbor: Tensor
    wet: Tensor
    place: Tensor
    speed: Tensor | None
    volume: Tensor
    own_volume: float
    radius: float
    dimension: int
    count: int

    @classmethod
    def of(cls, particles: Particles, edges: Neighbors, solids: Tensor) -> Edges:
        """Return the edges, given the volumes (M,) of the solids, m³."""
        count, scene = len(particles), particles.scene
        own_volume = scene.particle_volume
        solids = solids.to(particles.position.dtype)
        volumes = torch.cat([solids.new_full((count,), own_volume), solids])
        both = torch.cat([particles.position, particles.solid_position])
        wet = edges.neighbor < count
        speed = None
        if particles.solids_move:
            at_rest = torch.zeros_like(particles.position)
            speeds = torch.cat([at_rest, particles.solid_velocity.to(at_rest.dtype)])
            speed = speeds.index_select(0, edges.neighbor)
        return cls(
            particle=edges.particle,
            neighbor=edges.neighbor.where(wet, 0),
            wet=wet,
            place=both.index_select(0, edges.neighbor),
            speed=speed,
            volume=volumes.index_select(0, edges.neighbor),
            own_volume=own_volume,
            radius=scene.support_radius,
            dimension=scene.dimension,
            count=count,
        )

    def at(self, position: Tensor, time: float = 0.0) -> Gradients:
        """Return the gradients at positions (N, 3), m, at a time from the middle, s."""
        other = position.index_select(0, self.neighbor)
        place = self.place if self.speed is None else self.place + time * self.speed
        other = torch.where(self.wet[:, None], other, place)
        offset = position.index_select(0, self.particle) - other
        distance = torch.linalg.vector_norm(offset, dim=1) + 1e-8 * self.radius
        kernel = self.radius, self.dimension
        gradient = (self.volume * spline_slope(distance, *kernel) / distance)[:, None] * offset
        density = self.sum(self.volume * cubic_spline(distance, *kernel))
        density = density + self.own_volume * spline_height(*kernel)
        squares = gradient.square().sum(dim=1) * self.wet
        diagonal = self.sum(gradient).square().sum(dim=1) + self.sum(squares)
        stiffness = 1 / (diagonal + REGULARIZATION / self.radius**2)
        return Gradients(self, offset, gradient, density, stiffness)

    def wet_edges(self) -> Neighbors:
        """Return the edges between fluid particles."""
        return Neighbors.from_edges(self.particle[self.wet], self.neighbor[self.wet], self.count)

    def describe(self, position: Tensor) -> Tensor:
        """Return density, its gradient and the moments of the walls at positions, (N, 14)."""
        at = self.at(position)
        share = self.volume / self.own_volume * ~self.wet
        moments = [self.sum(share * weight) for weight in moment_weights(-at.offset / self.radius)]
        return torch.cat(
            [
                at.density[:, None],
                self.radius * self.sum(at.gradient),
                torch.stack(moments, dim=1),
            ],
            dim=1,
        )

    def sum(self, values: Tensor) -> Tensor:
        """Return the sum over the edges (E, ...) of each particle, (N, ...)."""
        zeros = values.new_zeros(self.count, *values.shape[1:])
        return zeros.index_add(0, self.particle, values)


@final
@dataclass(frozen=True)
class Gradients:
    """V∇W of each edge at a place of the particles, and the operations that it defines.

    Attributes:
        edges: The edges.
        offset: (E, 3) from neighbor to particle, m.
        gradient: (E, 3) V∇W, 1/m.
        density: (N,) ρ/ρ₀.
        stiffness: (N,) α, m².
    """

    edges: Edges
    offset: Tensor
    gradient: Tensor
    density: Tensor
    stiffness: Tensor

    def divergence(self, velocity: Tensor) -> Tensor:
        """Return D v, the rate of ρ/ρ₀ (N,), 1/s."""
        return self.edges.sum((self.gradient * self._relative(velocity)).sum(dim=1))

    def push(self, pressure: Tensor) -> Tensor:
        """Return Σ V∇W (p_i + p_j), (N, 3) m/s; a solid has no pressure of its own."""
        edges = self.edges
        both = pressure.index_select(0, edges.particle) + (
            pressure.index_select(0, edges.neighbor) * edges.wet
        )
        return edges.sum(self.gradient * both[:, None])

    def viscous(self, velocity: Tensor) -> Tensor:
        """Return the viscous acceleration (N, 3) over 2(d + 2)ν, between fluid particles."""
        edges = self.edges
        along = (self._relative(velocity) * self.offset).sum(dim=1) * edges.wet
        along = along / (self.offset.square().sum(dim=1) + 0.01 * edges.radius**2)
        along = along / self.density.index_select(0, edges.neighbor)
        return edges.sum(along[:, None] * self.gradient)

    def _relative(self, velocity: Tensor) -> Tensor:
        """Return v_i - v_j of each edge, (E, 3)."""
        edges = self.edges
        other = velocity.index_select(0, edges.neighbor) * edges.wet[:, None]
        if edges.speed is not None:
            other = other + edges.speed
        return velocity.index_select(0, edges.particle) - other
