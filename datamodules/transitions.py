"""States and what follows them, read from files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import torch
from torch.utils.data import Dataset

from datamodules.augmentation import Augmentation
from datamodules.reader import FrameReader
from fluidsnet.particles import Transitions


@dataclass(frozen=True)
class Sample:
    """Where a transition starts."""

    reader: FrameReader
    simulation: str
    frame: int


@final
class TransitionDataset(Dataset[Transitions]):
    """States and what follows, each frame of a sample read once.

    Args:
        samples: where the transitions start.
        stride: frames from a state to the next.
        steps: next states per sample.
        augmentation: changes a sample after it was read.
    """

    def __init__(
        self,
        samples: Sequence[Sample],
        stride: int,
        steps: int,
        augmentation: Augmentation | None = None,
    ) -> None:
        self.samples, self.stride, self.steps = samples, stride, steps
        self.augmentation = augmentation
        # By its file too: one name may be in several.
        names = dict.fromkeys((sample.reader.path, sample.simulation) for sample in samples)
        self._numbers = {name: number for number, name in enumerate(names)}

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Transitions:
        sample = self.samples[index]
        reader, simulation = sample.reader, sample.simulation
        state = reader.state(simulation, sample.frame, reader.scene(self.stride))
        later = [
            reader.fluid(simulation, sample.frame + step * self.stride)
            for step in range(1, self.steps + 1)
        ]
        transitions = Transitions(
            state=state,
            next_position=torch.stack([position for position, _ in later]),
            next_velocity=torch.stack([velocity for _, velocity in later]),
            simulation=torch.tensor([self._numbers[reader.path, simulation]]),
        )
        return transitions if self.augmentation is None else self.augmentation(transitions)
