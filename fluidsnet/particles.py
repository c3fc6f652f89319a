"""Particles: one batch of states, each field named once with its shape and unit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import torch
from torch import Tensor

from fluidsnet.batch import COUNT, FRAME_INDEX, PART, ROWS, STEPS_AND_ROWS, Batch, Movable
from fluidsnet.scene import Scene


@dataclass(frozen=True, repr=False)
class Particles(Batch):
    """The states of one or more frames, frame after frame.

    Attributes:
        position: (N, 3) of the fluid particles, m.
        velocity: (N, 3) of the fluid particles, m/s.
        frame: (N,) int64, index in the batch of each fluid particle's frame; ascending.
        solid_position: (M, 3) of the solid particles, m.
        solid_velocity: (M, 3) of the solid particles, m/s; zero where they rest.
        solid_frame: (M,) int64, as `frame`.
        frames: Number of frames in the batch.
        scene: Scene with a row for each frame.
    """

    position: Tensor = field(metadata=ROWS)
    velocity: Tensor = field(metadata=ROWS)
    frame: Tensor = field(metadata=FRAME_INDEX)
    solid_position: Tensor = field(metadata=ROWS)
    solid_velocity: Tensor = field(metadata=ROWS)
    solid_frame: Tensor = field(metadata=FRAME_INDEX)
    frames: int = field(metadata=COUNT)
    scene: Scene = field(metadata=PART)

    @classmethod
    def single(
        cls, position: Tensor, velocity: Tensor, solid_position: Tensor, scene: Scene
    ) -> Particles:
        """Return a batch of one frame with its solids at rest.

        Args:
            position: (N, 3) m.
            velocity: (N, 3) m/s.
            solid_position: (M, 3) m.
            scene: Scene of the frame.
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

    def __repr__(self) -> str:
        counts = f"{len(self):,} fluid, {len(self.solid_position):,} solid"
        return f"Particles({counts}, frames={self.frames}, device={self.position.device})"

    def moved(self, position: Tensor, velocity: Tensor) -> Particles:
        """Return the particles with a new position (N, 3), m, and velocity (N, 3), m/s."""
        return replace(self, position=position, velocity=velocity)

    def per_particle(self, values: Tensor) -> Tensor:
        """Return rows of a value per frame that broadcast against the fluid particles.

        Args:
            values: (F, ...) a row for each frame, such as `scene.gravity`.

        Returns:
            (N, ...) each particle's row; (1, ...) where there is one frame.
        """
        return values if self.frames == 1 else values.index_select(0, self.frame)

    def __len__(self) -> int:
        """Return the number of fluid particles."""
        return len(self.position)


@dataclass(frozen=True)
class Transitions(Batch):
    """States and the true states one or more steps later.

    Attributes:
        state: N particles.
        next_position: (S, N, 3) after 1, 2, … S steps, m.
        next_velocity: (S, N, 3) m/s.
        simulation: (F,) int64, number of the simulation of each frame.
    """

    state: Particles = field(metadata=PART)
    next_position: Tensor = field(metadata=STEPS_AND_ROWS)
    next_velocity: Tensor = field(metadata=STEPS_AND_ROWS)
    simulation: Tensor = field(metadata=ROWS)


class Truth(Protocol):
    """True states of a simulation, read one at a time so that they are never all in memory."""

    def __len__(self) -> int:
        """Return the number of states, the start included."""
        ...

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        """Return position and velocity, each (N, 3) on the CPU, so many steps after the start."""
        ...


@dataclass(frozen=True)
class RolloutStart(Movable):
    """Start state, length and true states of one rollout.

    Attributes:
        name: Name of the simulation.
        state: State that the rollout starts from.
        steps: Number of steps to roll out.
        truth: True states from the start on; may end before the rollout does.
        first: Frame of the simulation that the rollout starts at.
    """

    name: str
    state: Particles
    steps: int
    truth: Truth
    first: int

    @property
    def known_steps(self) -> int:
        """Number of steps that have a true state."""
        return min(self.steps, len(self.truth) - 1)


class RolloutStarts(Protocol):
    """Sequence of rollout starts, each read when it is indexed.

    Attributes:
        names: Name of the simulation of each start.
        first: Frame of each start.
        steps: Number of steps of each rollout.
        known_steps: Number of steps of each rollout that have a true state.
    """

    names: list[str]
    first: list[int]
    steps: list[int]
    known_steps: list[int]

    def __len__(self) -> int:
        """Return the number of rollouts."""
        ...

    def __getitem__(self, index: int) -> RolloutStart:
        """Return one start, on the CPU."""
        ...
