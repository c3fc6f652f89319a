"""Particles: one batch of states, each field named once with its shape and unit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, Self

import torch
from torch import Tensor

from fluidsnet.scene import Scene


@dataclass(frozen=True)
class _Batch:
    """Moves every tensor, and everything that can be moved, of a dataclass at once."""

    def to(self, device: torch.device | str, non_blocking: bool = False) -> Self:
        """The batch on a device."""
        return self._each(lambda value: value.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> Self:
        """The batch in page-locked memory, for an asynchronous copy to a GPU."""
        return self._each(lambda value: value.pin_memory())

    def _each(self, change: Callable[[Any], Any]) -> Self:
        changed = {
            field.name: change(getattr(self, field.name))
            for field in fields(self)
            if isinstance(getattr(self, field.name), Tensor | Scene | _Batch)
        }
        return replace(self, **changed)


@dataclass(frozen=True)
class Particles(_Batch):
    """The states of one or more frames of one scene, one frame's particles after another's.

    Attributes:
        position: (N, 3) of the fluid particles, m.
        velocity: (N, 3) of the fluid particles, m/s.
        frame: (N,) int64, which frame of the batch a fluid particle is in; ascending.
        solid_position: (M, 3) of the solid particles, m.
        solid_velocity: (M, 3) of the solid particles, m/s; zero where they rest.
        solid_frame: (M,) int64, as `frame`.
        frames: number of frames in the batch.
        scene: of all of them.
    """

    position: Tensor
    velocity: Tensor
    frame: Tensor
    solid_position: Tensor
    solid_velocity: Tensor
    solid_frame: Tensor
    frames: int
    scene: Scene

    @classmethod
    def single(
        cls, position: Tensor, velocity: Tensor, solid_position: Tensor, scene: Scene
    ) -> Particles:
        """One frame, its solids at rest.

        Args:
            position: (N, 3) m.
            velocity: (N, 3) m/s.
            solid_position: (M, 3) m.
            scene: around them.
        """
        return cls(
            position=position,
            velocity=velocity,
            frame=position.new_zeros(len(position), dtype=torch.int64),
            solid_position=solid_position,
            solid_velocity=torch.zeros_like(solid_position),
            solid_frame=solid_position.new_zeros(len(solid_position), dtype=torch.int64),
            frames=1,
            scene=scene,
        )

    @classmethod
    def collate(cls, states: Sequence[Particles]) -> Particles:
        """Joins states of one scene into one batch, in the order given."""
        offsets = [0]
        for state in states:
            offsets.append(offsets[-1] + state.frames)
        return cls(
            position=torch.cat([state.position for state in states]),
            velocity=torch.cat([state.velocity for state in states]),
            frame=torch.cat(
                [state.frame + offset for state, offset in zip(states, offsets, strict=False)]
            ),
            solid_position=torch.cat([state.solid_position for state in states]),
            solid_velocity=torch.cat([state.solid_velocity for state in states]),
            solid_frame=torch.cat(
                [state.solid_frame + offset for state, offset in zip(states, offsets, strict=False)]
            ),
            frames=offsets[-1],
            scene=states[0].scene,
        )

    def moved(self, position: Tensor, velocity: Tensor) -> Particles:
        """The same particles elsewhere: position (N, 3) in m, velocity (N, 3) in m/s."""
        return replace(self, position=position, velocity=velocity)

    def __len__(self) -> int:
        """Number of fluid particles."""
        return len(self.position)


@dataclass(frozen=True)
class Transitions(_Batch):
    """States, and where their particles truly are one or more steps later.

    Attributes:
        state: N particles.
        next_position: (S, N, 3) after 1, 2, … S steps, m.
        next_velocity: (S, N, 3) m/s.
        simulation: (F,) int64, number of the simulation that each frame is of.
    """

    state: Particles
    next_position: Tensor
    next_velocity: Tensor
    simulation: Tensor

    @classmethod
    def collate(cls, samples: Sequence[Transitions]) -> Transitions:
        """Joins samples with the same number of steps into one batch."""
        return cls(
            state=Particles.collate([sample.state for sample in samples]),
            next_position=torch.cat([sample.next_position for sample in samples], dim=1),
            next_velocity=torch.cat([sample.next_velocity for sample in samples], dim=1),
            simulation=torch.cat([sample.simulation for sample in samples]),
        )


class Truth(Protocol):
    """The frames of a simulation, read one at a time so that they never sit in memory."""

    def __len__(self) -> int:
        """Number of steps there are, the start included."""
        ...

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        """Position and velocity, each (N, 3), on the CPU, this many steps after the start."""
        ...


@dataclass(frozen=True)
class RolloutStart(_Batch):
    """Where a rollout starts, how far it goes, and what it is compared with.

    Attributes:
        name: of the simulation.
        state: its first frame.
        steps: number of steps to roll out.
        truth: the simulation's own frames; may end before the rollout does.
    """

    name: str
    state: Particles
    steps: int
    truth: Truth


class RolloutStarts(Protocol):
    """Rollouts that can be compared with the truth; each start is read when it is asked for.

    Attributes:
        names: the simulation of each start.
        first: the frame of each start.
        steps: of each rollout, all with a truth.
    """

    names: list[str]
    first: list[int]
    steps: list[int]

    def __len__(self) -> int:
        """Number of rollouts."""
        ...

    def __getitem__(self, index: int) -> RolloutStart:
        """One of them, on the CPU."""
        ...
