"""Trainings that differ in their seed alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fluidsnet.studies.ablations.numbers import REST, Lookup, Numbers

#: The time in s at which rollouts are looked at, beside their end.
MIDDLE = 0.25


@dataclass(frozen=True)
class Moment:
    """A row of a table of rollouts.

    Attributes:
        steps: of the network.
        time: of as many steps, s.
    """

    steps: int
    time: float


@dataclass(frozen=True)
class Group:
    """The runs of one scene and stride.

    Attributes:
        scene: its name.
        stride: frames of the data a step of the network.
        runs: one a seed.
    """

    scene: str
    stride: int
    runs: tuple[Numbers, ...]

    @property
    def seeds(self) -> str:
        """How many, in words."""
        return f"{len(self.runs)} seed{'s' * (len(self.runs) != 1)}"

    @property
    def step(self) -> str:
        """The time step in words."""
        known = (run.time_step for run in self.runs if run.time_step is not None)
        time_step = next(known, None)
        return f"stride {self.stride}" if time_step is None else f"{1000 * time_step:.4g} ms a step"

    @property
    def title(self) -> str:
        """For a heading."""
        stride = "" if self.step == f"stride {self.stride}" else f" (stride {self.stride})"
        return f"{self.scene}, {self.step}{stride}, {self.seeds}"

    def values(self, number: Lookup) -> list[float]:
        """A number of each run that has it."""
        found = (number(run) for run in self.runs)
        return [value for value in found if value is not None]

    def moments(self, start: str = REST) -> list[Moment]:
        """That near `MIDDLE`, where there is one before the end, and the end.

        Args:
            start: the table of the rollouts.
        """
        rows = {steps: time for run in self.runs for steps, time in run.times(start).items()}
        known = [Moment(steps, time) for steps, time in sorted(rows.items())]
        before = sorted(known[:-1], key=lambda moment: abs(moment.time - MIDDLE))
        return [*before[:1], *known[-1:]]


def grouped(numbers: Sequence[Numbers]) -> list[Group]:
    """Groups by scene and stride, in their order; the runs of each in that of their seeds."""
    found: dict[tuple[str, int], list[Numbers]] = {}
    for one in numbers:
        found.setdefault((one.trained.scene, one.trained.stride), []).append(one)
    return [
        Group(scene, stride, tuple(sorted(runs, key=lambda run: run.trained.seed)))
        for (scene, stride), runs in sorted(found.items())
    ]
