"""Symmetries of a box under gravity: they make new training data of old."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import torch
from torch import Tensor

from fluidsnet.errors import UserError
from fluidsnet.particles import Particles, Transitions
from fluidsnet.scene import Scene


class Augmentation(ABC):
    """Changes a training sample into another one that is as true."""

    @abstractmethod
    def check(self, scene: Scene) -> None:
        """Called once before training starts.

        Raises:
            UserError: a changed sample would not be true in this scene.
        """

    @abstractmethod
    def __call__(self, sample: Transitions) -> Transitions:
        """One random change of a single sample."""


@final
class BoxSymmetry(Augmentation):
    """Mirrors each horizontal axis, and swaps the two, each with probability one half.

    Together they are the rotations about gravity by quarter turns and their mirror
    images: all that map the box to itself. The two axes are swapped only where the box is
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
        scene = sample.state.scene
        self.check(scene)
        along = scene.gravity.abs() > 0
        first, second = (axis for axis in range(3) if not bool(along[axis]))
        draws = torch.rand(3, device=scene.gravity.device) < 0.5
        axes = [0, 1, 2]
        if bool(draws[0]) and bool(torch.isclose(scene.extent[first], scene.extent[second])):
            axes[first], axes[second] = second, first
        sign = torch.ones(3, device=scene.gravity.device)
        sign[first] = -1.0 if bool(draws[1]) else 1.0
        sign[second] = -1.0 if bool(draws[2]) else 1.0
        center = (scene.domain_lower + scene.domain_upper) / 2

        def place(position: Tensor) -> Tensor:
            return (position - center)[..., axes] * sign + center

        def turn(velocity: Tensor) -> Tensor:
            return velocity[..., axes] * sign

        state = sample.state
        return Transitions(
            state=Particles(
                position=place(state.position),
                velocity=turn(state.velocity),
                frame=state.frame,
                solid_position=place(state.solid_position),
                solid_velocity=turn(state.solid_velocity),
                solid_frame=state.solid_frame,
                frames=state.frames,
                scene=scene,
            ),
            next_position=place(sample.next_position),
            next_velocity=turn(sample.next_velocity),
            simulation=sample.simulation,
        )
