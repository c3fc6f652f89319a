"""Where rollouts start that are compared with the truth, from any frame."""

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
    """The states of a simulation, a stride apart, read one at a time.

    Args:
        reader: of its file.
        simulation: its name.
        stride: frames from a state to the next.
        first: frame of the first state.
    """

    def __init__(self, reader: FrameReader, simulation: str, stride: int, first: int = 0) -> None:
        self.reader, self.simulation = reader, simulation
        self.stride, self.first = stride, first

    def __len__(self) -> int:
        return (self.reader.frames[self.simulation] - 1 - self.first) // self.stride + 1

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor]:
        return self.reader.fluid(self.simulation, self.first + step * self.stride)


@final
class RolloutStarts(Dataset[RolloutStart]):
    """Each of some frames of each of some simulations, and the truth from there on.

    Args:
        reader: of a file.
        stride: frames from a state to the next.
        frames: where rollouts start: a whole number is a frame; a fraction is a share of the
            simulation, from 0.0 to below 1.
        steps: of each rollout; it ends where the truth does, and there by default.
        simulations: how many, from the file's first on; all by default.

    Attributes:
        names: the simulation of each start.
        first: the frame of each start.
        steps: of each rollout.

    Raises:
        UserError: no rollout can start there.
    """

    def __init__(
        self,
        reader: FrameReader,
        stride: int,
        frames: Sequence[int | float],
        steps: int | None = None,
        simulations: int | None = None,
    ) -> None:
        self.reader, self.stride = reader, stride
        self.names: list[str] = []
        self.first: list[int] = []
        self.steps: list[int] = []
        for name in list(reader.frames)[:simulations]:
            count = reader.frames[name]
            for frame in frames:
                first = frame if isinstance(frame, int) else round(frame * (count - 1))
                there = (count - 1 - first) // stride
                if first < 0 or there < 1:
                    raise UserError(
                        f"{reader.path}: no rollout of /{name} can start at {frame} (a whole "
                        f"number is a frame, a fraction a share): it has {count} frames, and a "
                        f"step takes {stride}."
                    )
                self.names.append(name)
                self.first.append(first)
                self.steps.append(there if steps is None else min(steps, there))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> RolloutStart:
        name, first = self.names[index], self.first[index]
        return RolloutStart(
            name=name,
            state=self.reader.state(name, first, self.reader.scene(self.stride)),
            steps=self.steps[index],
            truth=SimulationTruth(self.reader, name, self.stride, first),
        )


@final
class RolloutDataset(Dataset[RolloutStart]):
    """The first frame of each simulation.

    Args:
        reader: of a file.
        stride: frames from a state to the next.
        steps: of each rollout; as many as the simulation has by default.
    """

    def __init__(self, reader: FrameReader, stride: int, steps: int | None) -> None:
        self.reader, self.stride, self.steps = reader, stride, steps
        self.names = list(reader.frames)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> RolloutStart:
        name = self.names[index]
        truth = SimulationTruth(self.reader, name, self.stride)
        return RolloutStart(
            name=name,
            state=self.reader.state(name, 0, self.reader.scene(self.stride)),
            steps=len(truth) - 1 if self.steps is None else self.steps,
            truth=truth,
        )
