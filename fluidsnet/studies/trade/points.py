"""Points of the trade study: ways to continue true states, with their cost."""

from __future__ import annotations

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, final

import h5py
import torch

from datamodules.generate.replay import Replay, replay
from datamodules.reader import FrameReader
from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.errors import UserError
from fluidsnet.models import config_path, load
from fluidsnet.particles import Particles
from fluidsnet.rollout import with_solids
from fluidsnet.studies.trade.options import ModelPoint, SolverPoint

#: Start frame and number of frames of each continuation.
Runs = list[tuple[int, int]]


@final
@dataclass(frozen=True)
class Continued:
    """State that a point computed.

    Attributes:
        run: Number of the continuation.
        frame: Frames since its start.
        state: State.
        wall: Wall time of a frame, s.
        cpu: Time of all cores for a frame, s.
    """

    run: int
    frame: int
    state: Particles
    wall: float
    cpu: float


class Point(ABC):
    """A way to continue true states.

    Attributes:
        label: Name in the tables.
        kind: Kind, for the figure: trivial, solver, prior alone or network.
        stride: Frames from one state to the next.
    """

    label: str
    kind: str
    stride: int = 1

    @property
    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Settings that the results depend on, as JSON values."""

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

    def continued(
        self, reader: FrameReader, simulation: str, runs: Runs, advance: Callable[[], None]
    ) -> Iterator[Continued]:
        for run, (first, frames) in enumerate(runs):
            start = reader.state(simulation, first, 1)
            for frame in range(1, frames + 1):
                yield Continued(run, frame, self._predict(start, frame), 0.0, 0.0)


@final
class Solver(Point):
    """The solver, restarted from true states."""

    kind = "solver"

    def __init__(self, point: SolverPoint, data: Path, threads: int) -> None:
        self.label, self._point, self._data, self._threads = point.label, point, data, threads
        with h5py.File(data) as file:
            interval = float(file.attrs["dt"])
        ratio = max(point.step / interval, interval / point.step)
        if abs(ratio - round(ratio)) > 1e-6:
            raise UserError(
                f"The solver's step of {point.step:g} s neither divides the frame interval of "
                f"{data}, {interval:g} s, nor is a multiple of it."
            )
        self.stride = max(round(point.step / interval), 1)

    @property
    def settings(self) -> dict[str, Any]:
        return {**asdict(self._point), "threads": self._threads}

    def continued(
        self, reader: FrameReader, simulation: str, runs: Runs, advance: Callable[[], None]
    ) -> Iterator[Continued]:
        point = self._point
        job = Replay(
            data=str(self._data.resolve()),
            simulation=simulation,
            solver=point.solver,
            solver_step=point.step,
            tolerance=point.tolerance,
            threads=self._threads,
            runs=runs,
        )
        start = reader.state(simulation, 0, 1)
        for run, frame, made in replay(job, advance):
            state = start.moved(torch.from_numpy(made.position), torch.from_numpy(made.velocity))
            yield Continued(run, frame, state, made.wall, made.cpu)


@final
class ModelSteps(Point):
    """A model in evaluation mode.

    Raises:
        UserError: The model cannot be loaded, or its step is no multiple of the frame interval.
    """

    def __init__(self, point: ModelPoint, reader: FrameReader, threads: int) -> None:
        self.label = point.label or point.model
        self._point, self._threads, self._model = (
            point,
            threads,
            load(point.model, prior=point.prior),
        )
        self.stride = point.stride
        self.kind = "network" if self._model.network.target.width else "prior alone"
        if step := float(self._model.time_step):
            self.stride = round(step / reader.header.dt)
            if abs(self.stride * reader.header.dt - step) > 1e-6 * step or not self.stride:
                raise UserError(
                    f"{point.model} has a time step of {step:g} s, which is no multiple of the "
                    f"frame interval, {reader.header.dt:g} s."
                )

    @property
    def settings(self) -> dict[str, Any]:
        described: Any
        if self.kind == "network":
            # Weights and buffers: a run can be trained anew in its folder.
            described = [float(it.double().sum()) for it in self._model.state_dict().values()]
        else:
            # Its numbers, too: the config leaves some to their defaults.
            prior = vars(self._model.prior).items()
            described = {
                "config": config_path(self._point.model).read_text(encoding="utf-8"),
                "prior": {name: it for name, it in prior if isinstance(it, int | float)},
            }
        return {**asdict(self._point), "threads": self._threads, "described": described}

    @torch.no_grad()
    def continued(
        self, reader: FrameReader, simulation: str, runs: Runs, advance: Callable[[], None]
    ) -> Iterator[Continued]:
        torch.set_num_threads(self._threads)
        # Compiles its kernels.
        self._model.step(reader.state(simulation, runs[0][0], self.stride))
        for run, (first, frames) in enumerate(runs):
            state = reader.state(simulation, first, self.stride)
            solids = reader.motion(simulation, first, self.stride)
            for step, frame in enumerate(range(self.stride, frames + 1, self.stride), start=1):
                wall, cpu = time.perf_counter(), time.process_time()
                state = self._model.step(state)
                wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
                state = with_solids(state, solids, step)
                yield Continued(run, frame, state, wall / self.stride, cpu / self.stride)
            advance()


def check_drawn(data: Path, simulation: str) -> None:
    """Check that the solver can continue a simulation: one that `generate` drew, solids at rest.

    Raises:
        UserError: It is of another kind.
    """
    with h5py.File(data) as file:
        notes = file[simulation].attrs.get("scene_parameters", "{}")
        moving = file[simulation]["solid_position"].ndim == 3
    if moving:
        raise UserError(
            f"{data}: the solids of /{simulation} move, and the solver cannot be restarted with "
            "them; set --solvers []."
        )
    if not isinstance(json.loads(notes), list):
        raise UserError(
            f"{data}: /{simulation} is no scene that `fluidsnet generate` drew, and the solver "
            "cannot be restarted in it; set --solvers []."
        )
