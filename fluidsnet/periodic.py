"""Periodic axes: wrapped positions, shortest differences, and images across the faces."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from fluidsnet.particles import Particles
from fluidsnet.scene import Scene


def is_periodic(scene: Scene) -> bool:
    """Return whether an axis of the scene is periodic."""
    return any(scene.periodic)


def wrapped(particles: Particles) -> Particles:
    """Return the particles with positions in the box along periodic axes."""
    scene = particles.scene
    if not is_periodic(scene):
        return particles

    def inside(position: Tensor, frame: Tensor) -> Tensor:
        lower, extent = scene.domain_lower[frame], scene.extent[frame]
        turns = torch.floor((position - lower) / extent)
        return position - turns * extent * _axes(particles)

    return replace(
        particles,
        position=inside(particles.position, particles.frame),
        solid_position=inside(particles.solid_position, particles.solid_frame),
    )


def shortest(difference: Tensor, particles: Particles) -> Tensor:
    """Return differences of positions (N, 3), m, by the shortest way across periodic axes.

    Args:
        difference: (N, 3) of the fluid particles, m.
        particles: State whose scene has the box.
    """
    if not is_periodic(particles.scene):
        return difference
    extent = particles.per_particle(particles.scene.extent)
    return difference - torch.round(difference / extent) * extent * _axes(particles)


def with_images(particles: Particles) -> Particles:
    """Return the wrapped particles with their images within a support radius of the box.

    The images are solid rows, those of fluid marked by `fluid_image`, so that every search and
    local feature sees across periodic faces. A box narrower than a support radius has several
    images of a particle, also for the particle itself.
    """
    scene = particles.scene
    if not is_periodic(scene):
        return particles
    particles = wrapped(particles)
    count, radius = len(particles), scene.support_radius
    position = torch.cat([particles.position, particles.solid_position])
    row = torch.arange(len(position), device=position.device)
    frame = torch.cat([particles.frame, particles.solid_frame])
    for axis in range(3):
        if not scene.periodic[axis]:
            continue
        edge = scene.extent[:, axis]
        lower, upper = scene.domain_lower[:, axis] - radius, scene.domain_upper[:, axis] + radius
        layers = max(math.ceil(radius / edges[axis]) for edges in scene.edges)
        places, rows, frames = [position], [row], [frame]
        for shift in (it for it in range(-layers, layers + 1) if it):
            moved = position.clone()
            moved[:, axis] += shift * edge[frame]
            near = (moved[:, axis] >= lower[frame]) & (moved[:, axis] <= upper[frame])
            # A GPU is waited for here, to know how many there are, and nowhere else.
            reached = near.nonzero().squeeze(1)
            places.append(moved.index_select(0, reached))
            rows.append(row.index_select(0, reached))
            frames.append(frame.index_select(0, reached))
        position, row, frame = torch.cat(places), torch.cat(rows), torch.cat(frames)
    velocity = torch.cat([particles.velocity, particles.solid_velocity])
    # Frame after frame; fluid rows come first and stay where they are.
    order = count + frame[count:].argsort(stable=True)
    row = row[order]
    return replace(
        particles,
        solid_position=position[order],
        solid_velocity=velocity[row],
        solid_frame=frame[order],
        solids_move=True,
        fluid_image=row < count,
    )


def _axes(particles: Particles) -> Tensor:
    """Return 1 for periodic axes and 0 for others, (3,)."""
    axes = torch.zeros_like(particles.scene.domain_lower[0])
    for axis, repeats in enumerate(particles.scene.periodic):
        axes[axis] = float(repeats)
    return axes
