"""Particles: one batch of states, each field named once with its shape and unit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import accumulate
from typing import Any, Protocol, Self

import torch
from torch import Tensor

from fluidsnet.scene import Scene


@dataclass(frozen=True)
class _Movable:
    """Base of the dataclasses that hold tensors: moves all of them at once."""

    def to(self, device: torch.device | str, non_blocking: bool = False) -> Self:
        """Return a copy on a device."""
        return self._each(lambda value: value.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> Self:
        """Return a copy in page-locked memory, for an asynchronous copy to a GPU."""
        return self._each(lambda value: value.pin_memory())

    def _each(self, change: Callable[[Any], Any]) -> Self:
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        movable = (Tensor, Scene, _Movable)
        return replace(
            self, **{n: change(value) for n, value in values.items() if isinstance(value, movable)}
        )


@dataclass(frozen=True)
class _Batch(_Movable):
    """Base of the batches. Each field's metadata has `join`: how its values are collated."""

    @classmethod
    def collate(cls, batches: Sequence[Self]) -> Self:
        """Join batches into one, in the order given.

        Raises:
            ValueError: there is no batch, or two of them differ in scene, number of steps,
                dtype or device.
        """
        if not batches:
            raise ValueError(f"cannot collate {cls.__name__}: there are no batches to join")
        return cls(
            **{entry.name: entry.metadata["join"](batches, entry.name) for entry in fields(cls)}
        )


def _concatenate(batches: Sequence[Any], name: str, axis: int = 0) -> Tensor:
    return torch.cat(_tensors(batches, name, axis), dim=axis)


def _frame_index(batches: Sequence[Any], name: str) -> Tensor:
    offsets = accumulate((batch.frames for batch in batches[:-1]), initial=0)
    frames = _tensors(batches, name, axis=0)
    return torch.cat([frame + offset for frame, offset in zip(frames, offsets, strict=True)])


def _tensors(batches: Sequence[Any], name: str, axis: int) -> list[Tensor]:
    """Return a field of each batch, and check that the tensors can be joined along an axis."""
    tensors: list[Tensor] = [getattr(batch, name) for batch in batches]
    first = tensors[0]
    for other in tensors[1:]:
        for what, one, two in (
            ("dtype", first.dtype, other.dtype),
            ("device", first.device, other.device),
            ("shape", _shape(first, axis), _shape(other, axis)),
        ):
            if one != two:
                raise ValueError(f"cannot collate {name}: its {what} is {one} and {two}")
    return tensors


def _shape(tensor: Tensor, axis: int) -> str:
    """Return the shape as text, with N for the axis that tensors are joined along."""
    sizes = (str(size) for size in tensor.shape)
    return f"({', '.join('N' if at == axis else size for at, size in enumerate(sizes))})"


def _sum(batches: Sequence[Any], name: str) -> int:
    return sum(getattr(batch, name) for batch in batches)


def _same_scene(batches: Sequence[Any], name: str) -> Scene:
    scene: Scene = getattr(batches[0], name)
    for batch in batches[1:]:
        # The identity test comes first: a comparison of values copies from a GPU to the host.
        other = getattr(batch, name)
        if other is not scene and (difference := scene.difference(other)):
            raise ValueError(f"cannot collate states of different scenes: {name}.{difference}")
    return scene


def _collate(batches: Sequence[Any], name: str) -> Any:
    parts = [getattr(batch, name) for batch in batches]
    return type(parts[0]).collate(parts)


_ROWS: dict[str, Any] = {"join": _concatenate}
_STEPS_AND_ROWS: dict[str, Any] = {"join": partial(_concatenate, axis=1)}
_FRAME_INDEX: dict[str, Any] = {"join": _frame_index}


@dataclass(frozen=True, repr=False)
class Particles(_Batch):
    """The states of one or more frames of one scene, frame after frame.

    Attributes:
        position: (N, 3) of the fluid particles, m.
        velocity: (N, 3) of the fluid particles, m/s.
        frame: (N,) int64, index in the batch of each fluid particle's frame; ascending.
        solid_position: (M, 3) of the solid particles, m.
        solid_velocity: (M, 3) of the solid particles, m/s; zero where they rest.
        solid_frame: (M,) int64, as `frame`.
        frames: Number of frames in the batch.
        scene: Scene of all frames.
    """

    position: Tensor = field(metadata=_ROWS)
    velocity: Tensor = field(metadata=_ROWS)
    frame: Tensor = field(metadata=_FRAME_INDEX)
    solid_position: Tensor = field(metadata=_ROWS)
    solid_velocity: Tensor = field(metadata=_ROWS)
    solid_frame: Tensor = field(metadata=_FRAME_INDEX)
    frames: int = field(metadata={"join": _sum})
    scene: Scene = field(metadata={"join": _same_scene})

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

    def __len__(self) -> int:
        """Return the number of fluid particles."""
        return len(self.position)


@dataclass(frozen=True)
class Transitions(_Batch):
    """States and the true states one or more steps later.

    Attributes:
        state: N particles.
        next_position: (S, N, 3) after 1, 2, … S steps, m.
        next_velocity: (S, N, 3) m/s.
        simulation: (F,) int64, number of the simulation of each frame.
    """

    state: Particles = field(metadata={"join": _collate})
    next_position: Tensor = field(metadata=_STEPS_AND_ROWS)
    next_velocity: Tensor = field(metadata=_STEPS_AND_ROWS)
    simulation: Tensor = field(metadata=_ROWS)


class Truth(Protocol):
    """True states of a simulation, read one at a time so that they are never all in memory."""

    def __len__(self) -> int:
        """Return the number of states, the start included."""
        ...

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        """Return position and velocity, each (N, 3) on the CPU, so many steps after the start."""
        ...


@dataclass(frozen=True)
class RolloutStart(_Movable):
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
