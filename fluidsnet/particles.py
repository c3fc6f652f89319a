"""Particles: one batch of states, each field named once with its shape and unit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import torch
from torch import Tensor

from fluidsnet.batch import (
    ANY,
    COUNT,
    FRAME_INDEX,
    OPTIONAL_PART,
    PART,
    ROWS,
    STEPS_AND_ROWS,
    Batch,
    Movable,
)
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
        solids_move: Whether a solid particle moves; False saves what motion costs.
        fluid_image: (M,) bool, solid rows that are images of fluid across a periodic axis; None
            where there are no images, see `fluidsnet.periodic`.
    """

    position: Tensor = field(metadata=ROWS)
    velocity: Tensor = field(metadata=ROWS)
    frame: Tensor = field(metadata=FRAME_INDEX)
    solid_position: Tensor = field(metadata=ROWS)
    solid_velocity: Tensor = field(metadata=ROWS)
    solid_frame: Tensor = field(metadata=FRAME_INDEX)
    frames: int = field(metadata=COUNT)
    scene: Scene = field(metadata=PART)
    solids_move: bool = field(default=False, metadata=ANY)
    fluid_image: Tensor | None = field(default=None, metadata=OPTIONAL_PART)

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

    def with_solids(self, position: Tensor, velocity: Tensor) -> Particles:
        """Return the particles with solids at positions (M, 3), m, that move, (M, 3) m/s."""
        return replace(self, solid_position=position, solid_velocity=velocity, solids_move=True)

    def with_solids_of(self, other: Particles) -> Particles:
        """Return the particles with the solids of another state of the same scene."""
        if not other.solids_move:
            return self
        return self.with_solids(other.solid_position, other.solid_velocity)

    def after_drift(self, time: float) -> Particles:
        """Return the particles with the solids where their velocities take them in a time, s."""
        if not self.solids_move:
            return self
        return replace(self, solid_position=self.solid_position + time * self.solid_velocity)

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


class SolidMotion(Protocol):
    """Prescribed motion of the solids of a scene."""

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        """Return position, m, and velocity, m/s, each (M, 3), after a step, counted from 1."""
        ...


@dataclass(frozen=True)
class SolidStates(Batch):
    """Motion of solids over S steps.

    Attributes:
        position: (S, M, 3) after 1, 2, … S steps, m.
        velocity: (S, M, 3) m/s.
    """

    position: Tensor = field(metadata=STEPS_AND_ROWS)
    velocity: Tensor = field(metadata=STEPS_AND_ROWS)

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        """Return position and velocity, each (M, 3), after a step, counted from 1."""
        return self.position[step - 1], self.velocity[step - 1]


@dataclass(frozen=True)
class Transitions(Batch):
    """States and the true states one or more steps later.

    Attributes:
        state: N particles.
        next_position: (S, N, 3) after 1, 2, … S steps, m.
        next_velocity: (S, N, 3) m/s.
        simulation: (F,) int64, number of the simulation of each frame.
        solids: The solids after each step; None where they rest.
    """

    state: Particles = field(metadata=PART)
    next_position: Tensor = field(metadata=STEPS_AND_ROWS)
    next_velocity: Tensor = field(metadata=STEPS_AND_ROWS)
    simulation: Tensor = field(metadata=ROWS)
    solids: SolidStates | None = field(default=None, metadata=OPTIONAL_PART)


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
        solids: Motion of the solids; None where they rest.
    """

    name: str
    state: Particles
    steps: int
    truth: Truth
    first: int
    solids: SolidMotion | None = None

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
