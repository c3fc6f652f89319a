"""Dataset of transitions, its statistics, and the sampler that evaluates each item once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence, Sized
from dataclasses import dataclass
from typing import Any, final

import torch
from torch import distributed
from torch.utils.data import Dataset, DistributedSampler

from datamodules.augmentation import Augmentation
from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.particles import Transitions
from fluidsnet.statistics import Statistics

#: Greatest number of samples that statistics are computed from.
STATISTICS_SAMPLES = 256


@dataclass(frozen=True)
class Sample:
    """File, simulation and frame that a transition starts at."""

    reader: FrameReader
    simulation: str
    frame: int


def samples_in(
    reader: FrameReader, span: int, frame_range: tuple[int, int | None], every: int
) -> list[Sample]:
    """Return the samples of a file, simulation after simulation.

    Args:
        reader: Reader of the file.
        span: Frames from a state to the last of its next states.
        frame_range: First frame that a sample may start at, and the frame it must end before;
            None for the end of the simulation.
        every: Frames between the starts of two samples.
    """
    first, end = frame_range
    return [
        Sample(reader, simulation, frame)
        for simulation, frames in reader.frames.items()
        for frame in range(first, (frames if end is None else min(frames, end)) - span, every)
    ]


@final
class TransitionDataset(Dataset[Transitions]):
    """Transitions read from files; each frame of a sample is read once.

    Args:
        samples: Starts of the transitions.
        stride: Frames from a state to the next.
        steps: Next states per sample.
        augmentation: Applied to each sample after it was read.
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
        # The path is part of the key: two files may have simulations of the same name.
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


def statistics(dataset: TransitionDataset) -> Statistics:
    """Compute means and deviations over samples spread evenly over a dataset.

    Args:
        dataset: Transitions of the training split.
    """
    every = math.ceil(len(dataset) / STATISTICS_SAMPLES)
    count = 0
    sums = torch.zeros(3, 3, dtype=torch.float64)
    squares = torch.zeros(3, 3, dtype=torch.float64)
    for index in range(0, len(dataset), every):
        sample = dataset[index]
        state = sample.state
        velocity = state.velocity.double()
        displacement = sample.next_position[0].double() - state.position.double()
        rows = torch.stack(
            [
                velocity,
                sample.next_velocity[0].double() - velocity,
                displacement - state.scene.time_step * velocity,
            ]
        )
        count += len(state)
        sums += rows.sum(dim=1)
        squares += rows.square().sum(dim=1)
    means = sums / count
    # One deviation for the three axes, so that no direction is stretched; never zero.
    deviations = (squares / count - means.square()).mean(dim=1).clamp_min(1e-24).sqrt()
    means, deviations = means.float(), deviations.float()
    return Statistics(
        velocity_mean=means[0],
        velocity_deviation=deviations[0],
        change_mean=means[1],
        change_deviation=deviations[1],
        drift_deviation=deviations[2],
    )


@final
class EachOnce(DistributedSampler[Any]):
    """Sampler that gives each item of a dataset to exactly one process, in order.

    Lightning's own sampler repeats the first items until every process has as many, which
    would count them twice.

    Args:
        dataset: Dataset to distribute; only its length is used.

    Raises:
        UserError: there are fewer items than processes.
    """

    def __init__(self, dataset: Sized) -> None:
        super().__init__(dataset, shuffle=False)  # type: ignore[arg-type]
        self.rows = range(self.rank, len(dataset), self.num_replicas)
        if len(dataset) < self.num_replicas:
            raise UserError(
                f"There are {self.num_replicas} processes and only {len(dataset)} samples or "
                "simulations, and each process needs one; set trainer.devices to fewer."
            )

    def __iter__(self) -> Iterator[int]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)


def each_once(dataset: Sized) -> EachOnce | None:
    """Return an `EachOnce` sampler where several processes share the work, else None."""
    together = distributed.is_available() and distributed.is_initialized()
    return EachOnce(dataset) if together else None
