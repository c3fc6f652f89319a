"""Points of the trade study: ways to continue true states, with their cost."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, final

from datamodules.reader import FrameReader
from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.particles import Particles

#: Start frame and number of frames of each continuation.
Runs = list[tuple[int, int]]


@final
@dataclass(frozen=True)
class Cost:
    """Cost of a state.

    Attributes:
        wall: Wall time of a frame, s.
        cpu: Time of all cores for a frame, s.
        setup: Wall time before the first step, s.
        memory: Most memory in use beyond that before the set-up, MB.
    """

    wall: float
    cpu: float
    setup: float
    memory: float


@final
@dataclass(frozen=True)
class Continued:
    """State that a point computed.

    Attributes:
        run: Number of the continuation.
        frame: Frames since its start.
        state: State.
        cost: Its cost.
    """

    run: int
    frame: int
    state: Particles
    cost: Cost


class Point(ABC):
    """A way to continue true states.

    Attributes:
        label: Name in the tables.
        kind: Kind, for the figure: trivial, solver, floor, prior alone or network.
        stride: Frames from one state to the next.
        paired: Its particles are those of the truth, row for row; else it is compared through
            fields, and continues the first frame alone.
    """

    label: str
    kind: str
    stride: int = 1
    paired: bool = True

    @property
    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Settings that the results depend on, as JSON values."""

    @property
    @abstractmethod
    def advice(self) -> str:
        """Sentence on how to use it."""

    @abstractmethod
    def continued(
        self, reader: FrameReader, simulation: str, runs: Runs, advance: Callable[[], None]
    ) -> Iterator[Continued]:
        """Yield the states of each continuation, a stride apart; nothing where it ended early.

        Args:
            reader: Reader of the true states.
            simulation: Name of the simulation.
            runs: What to continue.
            advance: Called now and then meanwhile.
        """


@final
class Trivial(Point):
    """A trivial predictor."""

    kind = "trivial"

    def __init__(self, name: str) -> None:
        self.label = name.replace("_", " ")
        self._predict = TRIVIAL_PREDICTORS[name]

    @property
    def settings(self) -> dict[str, Any]:
        return {"trivial": self.label}

    @property
    def advice(self) -> str:
        return f"It is the trivial predictor {self.label!r}."

    def continued(
        self, reader: FrameReader, simulation: str, runs: Runs, advance: Callable[[], None]
    ) -> Iterator[Continued]:
        for run, (first, frames) in enumerate(runs):
            start = reader.state(simulation, first, 1)
            for frame in range(1, frames + 1):
                yield Continued(run, frame, self._predict(start, frame), Cost(0.0, 0.0, 0.0, 0.0))
