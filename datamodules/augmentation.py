"""Augmentation of training samples by the symmetries of a box under gravity."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import final

import torch
from torch import Tensor

from fluidsnet.errors import UserError
from fluidsnet.particles import SolidStates, Transitions
from fluidsnet.scene import Scene


class Augmentation(ABC):
    """Random change of a training sample that keeps it physically true."""

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Check that changed samples are true in the scenes; called once before training.

        Raises:
            UserError: they are not.
        """

    @abstractmethod
    def __call__(self, sample: Transitions) -> Transitions:
        """Return a random change of a sample."""


@final
class BoxSymmetry(Augmentation):
    """Mirror each horizontal axis, and swap the two, each with probability one half.

    Together they are all symmetries of the box under gravity along one axis. The two axes are
    swapped only where the box is as wide as it is deep and both are periodic or neither is; in two
    dimensions there is only one.
    """

    def check(self, scene: Scene) -> None:
        for name, components in zip(scene.names, scene.gravity.tolist(), strict=True):
            if sum(component != 0 for component in components) != 1:
                gravity = ", ".join(f"{component:g}" for component in components)
                raise UserError(
                    f"The augmentation BoxSymmetry needs gravity along one axis, and in {name} it "
                    f"is ({gravity}) m/s²; leave out data.augmentation."
                )

    def __call__(self, sample: Transitions) -> Transitions:
        state, scene = sample.state, sample.state.scene
        self.check(scene)
        first, second = torch.nonzero(scene.gravity[0] == 0).flatten().tolist()
        swapped, *mirrored = (torch.rand(3, device=scene.gravity.device) < 0.5).tolist()
        axes, sign = [0, 1, 2], torch.ones(3, device=scene.gravity.device)
        flat, extent = scene.dimension == 2, scene.extent[0]
        # Periodic axes stay where they are.
        alike = scene.periodic[first] == scene.periodic[second]
        if swapped and alike and not flat and bool(torch.isclose(extent[first], extent[second])):
            axes[first], axes[second] = second, first
        sign[[first, second]] -= 2 * torch.tensor(mirrored, device=sign.device)
        sign[scene.dimension :] = 1
        center = (scene.domain_lower + scene.domain_upper) / 2

        def turn(velocity: Tensor) -> Tensor:
            return velocity[..., axes] * sign

        def place(position: Tensor) -> Tensor:
            return turn(position - center) + center

        state = replace(
            state,
            position=place(state.position),
            velocity=turn(state.velocity),
            solid_position=place(state.solid_position),
            solid_velocity=turn(state.solid_velocity),
        )
        positions, velocities = place(sample.next_position), turn(sample.next_velocity)
        solids = sample.solids
        if solids is not None:
            solids = SolidStates(place(solids.position), turn(solids.velocity))
        return replace(
            sample, state=state, next_position=positions, next_velocity=velocities, solids=solids
        )
