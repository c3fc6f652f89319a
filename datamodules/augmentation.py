"""Augmentation of training samples by the symmetries of a box under gravity."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import final

import torch
from torch import Tensor

from fluidsnet.errors import UserError
from fluidsnet.particles import Transitions
from fluidsnet.scene import Scene


class Augmentation(ABC):
    """Random change of a training sample that keeps it physically true."""

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Check that changed samples are true in a scene; called once before training.

        Raises:
            UserError: they are not.
        """

    @abstractmethod
    def __call__(self, sample: Transitions) -> Transitions:
        """Return a random change of a sample."""


@final
class BoxSymmetry(Augmentation):
    """Mirror each horizontal axis, and swap the two, each with probability one half.

    Together they are the rotations about gravity by quarter turns and their mirror
    images: all symmetries of the box. The two axes are swapped only where the box is
    as wide as it is deep.

    Raises:
        UserError: from `check` and when called, where gravity is not along one axis.
    """

    def check(self, scene: Scene) -> None:
        if int((scene.gravity.abs() > 0).sum()) != 1:
            gravity = ", ".join(f"{component:g}" for component in scene.gravity.tolist())
            raise UserError(
                "The augmentation BoxSymmetry needs gravity along one axis, and here it is "
                f"({gravity}) m/s²; leave out data.augmentation."
            )

    def __call__(self, sample: Transitions) -> Transitions:
        state, scene = sample.state, sample.state.scene
        self.check(scene)
        vertical = scene.gravity.abs() > 0
        first, second = (axis for axis in range(3) if not bool(vertical[axis]))
        draws = torch.rand(3, device=scene.gravity.device) < 0.5
        axes = [0, 1, 2]
        if bool(draws[0]) and bool(torch.isclose(scene.extent[first], scene.extent[second])):
            axes[first], axes[second] = second, first
        sign = torch.ones(3, device=scene.gravity.device)
        sign[first] = -1.0 if bool(draws[1]) else 1.0
        sign[second] = -1.0 if bool(draws[2]) else 1.0
        center = (scene.domain_lower + scene.domain_upper) / 2

        def turn(velocity: Tensor) -> Tensor:
            return velocity[..., axes] * sign

        def place(position: Tensor) -> Tensor:
            return turn(position - center) + center

        return replace(
            sample,
            state=replace(
                state,
                position=place(state.position),
                velocity=turn(state.velocity),
                solid_position=place(state.solid_position),
                solid_velocity=turn(state.solid_velocity),
            ),
            next_position=place(sample.next_position),
            next_velocity=turn(sample.next_velocity),
        )
