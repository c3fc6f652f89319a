"""Dataset of transitions, and its statistics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, final

import torch
from torch.utils.data import Dataset

from datamodules.augmentation import Augmentation
from datamodules.order import Draw
from datamodules.reader import FrameReader
from fluidsnet.particles import SolidStates, Transitions
from fluidsnet.periodic import shortest
from fluidsnet.rng import preserve_rng_state
from fluidsnet.scene import Scene
from fluidsnet.statistics import Statistics

#: Greatest number of samples that statistics are computed from.
STATISTICS_SAMPLES = 256


class Sample(NamedTuple):
    """File, simulation and frame that a transition starts at."""

    reader: FrameReader
    simulation: str
    frame: int


def samples_in(
    readers: Sequence[FrameReader], span: int, frame_range: tuple[int, int | None], every: int
) -> list[Sample]:
    """Return the samples of files, simulation after simulation.

    Args:
        readers: Readers of the files.
        span: Frames from a state to the last of its next states.
        frame_range: As for `SPHDataModule`.
        every: Frames between the starts of two samples.
    """
    first, end = frame_range
    return [
        Sample(reader, simulation, frame)
        for reader in readers
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

    Attributes:
        augmentation: Applied to each sample after it was read.
    """

    def __init__(self, samples: Sequence[Sample], stride: int, steps: int) -> None:
        self.samples, self.stride, self.steps = samples, stride, steps
        self.augmentation: Augmentation | None = None
        # The path is part of the key: two files may have simulations of the same name.
        names = dict.fromkeys((sample.reader.path, sample.simulation) for sample in samples)
        self._numbers = {name: number for number, name in enumerate(names)}
        simulations = {(sample.reader, sample.simulation) for sample in samples}
        self._solids_move = any(reader.motion(name, 0, 1) for reader, name in simulations)

    def __len__(self) -> int:
        return len(self.samples)

    def scenes(self) -> list[Scene]:
        """Return the scene of each simulation."""
        simulations = dict.fromkeys((sample.reader, sample.simulation) for sample in self.samples)
        return [reader.scene(name, self.stride) for reader, name in simulations]

    def __getitem__(self, draw: int | Draw) -> Transitions:
        index, seed = draw if isinstance(draw, Draw) else (draw, None)
        sample = self.samples[index]
        reader, simulation = sample.reader, sample.simulation
        state = reader.state(simulation, sample.frame, self.stride)
        frames = [sample.frame + step * self.stride for step in range(1, self.steps + 1)]
        later = [reader.fluid(simulation, frame) for frame in frames]
        transitions = Transitions(
            state=state,
            next_position=torch.stack([position for position, _ in later]),
            next_velocity=torch.stack([velocity for _, velocity in later]),
            simulation=torch.tensor([self._numbers[reader.path, simulation]]),
            solids=self._solids(reader, simulation, frames),
        )
        if self.augmentation is None:
            return transitions
        if seed is None:
            return self.augmentation(transitions)
        with preserve_rng_state():
            torch.default_generator.manual_seed(seed)
            return self.augmentation(transitions)

    def _solids(
        self, reader: FrameReader, simulation: str, frames: Sequence[int]
    ) -> SolidStates | None:
        """Return the solids in frames; None where those of all samples rest."""
        if not self._solids_move:
            return None
        states = [reader.solids(simulation, frame) for frame in frames]
        position, velocity = (torch.stack(it) for it in zip(*states, strict=True))
        return SolidStates(position, velocity)


def statistics(dataset: TransitionDataset) -> Statistics:
    """Compute means and deviations over samples spread evenly over a training split."""
    every = math.ceil(len(dataset) / STATISTICS_SAMPLES)
    count, sums, squares = 0, torch.zeros(3, 3).double(), torch.zeros(3, 3).double()
    for index in range(0, len(dataset), every):
        sample = dataset[index]
        state, velocity = sample.state, sample.state.velocity.double()
        displacement = sample.next_position[0].double() - state.position.double()
        displacement = shortest(displacement, state)
        change = sample.next_velocity[0].double() - velocity
        drift = (displacement - state.scene.time_step * velocity) / state.scene.support_radius
        rows = torch.stack([velocity, change, drift])
        count += len(state)
        sums += rows.sum(dim=1)
        squares += rows.square().sum(dim=1)
    means = sums / count
    # One deviation for all axes, so that no direction is stretched; never zero.
    axes = state.scene.dimension
    deviations = (squares / count - means.square())[:, :axes].mean(dim=1).clamp_min(1e-24).sqrt()
    means, deviations = means.float(), deviations.float()
    values = torch.cat([scene.values for scene in dataset.scenes()])
    least, greatest = values.min(dim=0).values, values.max(dim=0).values
    return Statistics(
        means[0], deviations[0], means[1], deviations[1], deviations[2], least, greatest
    )
