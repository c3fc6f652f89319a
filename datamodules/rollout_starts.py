"""Rollout starts and their true states, read from an HDF5 file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from torch import Tensor
from torch.utils.data import Dataset

from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.particles import RolloutStart


@final
class SimulationTruth:
    """True states of a simulation, from a frame on and a stride apart, read one at a time."""

    def __init__(self, reader: FrameReader, simulation: str, stride: int, first: int) -> None:
        self.reader, self.simulation = reader, simulation
        self.stride, self.first = stride, first

    def __len__(self) -> int:
        return (self.reader.frames[self.simulation] - 1 - self.first) // self.stride + 1

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        return self.reader.fluid(self.simulation, self.first + step * self.stride)


@final
class HDF5RolloutStarts(Dataset[RolloutStart]):
    """Rollout starts in the simulations of a file, each with its true states.

    Args:
        reader: Reader of the file.
        stride: Frames from a state to the next.
        frames: Where rollouts start: a whole number is a frame, a fraction is a share of the
            simulation, from 0.0 to below 1.
        steps: Number of steps of each rollout; by default up to the last true state.
        simulations: Number of simulations, from the first in the file; all by default.
        beyond_truth: Keep `steps` where the true states end earlier, also where there is none
            after the start. Without it, a rollout ends at the last true state.

    Raises:
        UserError: a rollout cannot start at one of the frames.
    """

    def __init__(
        self,
        reader: FrameReader,
        stride: int,
        frames: Sequence[int | float] = (0,),
        steps: int | None = None,
        simulations: int | None = None,
        beyond_truth: bool = False,
    ) -> None:
        self.reader, self.stride = reader, stride
        self.names: list[str] = []
        self.first: list[int] = []
        self.steps: list[int] = []
        self.known_steps: list[int] = []
        for name in list(reader.frames)[:simulations]:
            count = reader.frames[name]
            for frame in frames:
                first = frame if isinstance(frame, int) else round(frame * (count - 1))
                known = (count - 1 - first) // stride
                if not 0 <= first < count or (known < 1 and (steps is None or not beyond_truth)):
                    remedy = "; set data.rollout_steps to the number of steps to predict"
                    raise UserError(
                        f"{reader.path}: no rollout of /{name} can start at {frame} (a whole "
                        "number is a frame, a fraction a share of the simulation): it has "
                        f"{count} frame(s), and a step takes {stride}"
                        f"{remedy if beyond_truth and steps is None else ''}."
                    )
                self.names.append(name)
                self.first.append(first)
                rolled = known if steps is None else steps
                if beyond_truth and rolled > known and reader.motion(name, first, stride):
                    raise UserError(
                        f"{reader.path}: the solids of /{name} move, and their motion is known for "
                        f"{known} steps; set data.rollout_steps to {known} or fewer."
                    )
                self.steps.append(rolled if beyond_truth else min(rolled, known))
                self.known_steps.append(min(rolled, known))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> RolloutStart:
        name, first = self.names[index], self.first[index]
        return RolloutStart(
            name=name,
            state=self.reader.state(name, first, self.stride),
            steps=self.steps[index],
            truth=SimulationTruth(self.reader, name, self.stride, first),
            first=first,
            solids=self.reader.motion(name, first, self.stride),
        )
