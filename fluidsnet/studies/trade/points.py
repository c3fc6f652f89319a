"""Points of the trade study: ways to continue true states, with their cost."""

from __future__ import annotations

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, final

import h5py
import torch

from datamodules.generate.job import SolverName
from datamodules.generate.replay import Replay, replay
from datamodules.reader import FrameReader
from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.compiled import compile_network
from fluidsnet.errors import UserError
from fluidsnet.memory import PeakMemory
from fluidsnet.model import Model
from fluidsnet.models import config_path, load
from fluidsnet.particles import Particles
from fluidsnet.rollout import with_solids
from fluidsnet.studies.trade.options import ModelPoint, SolverPoint

#: Start frame and number of frames of each continuation.
Runs = list[tuple[int, int]]

# Noise on the start of the floor of chaos, particle radii.
_MOVED = 1e-3


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


@final
class Solver(Point):
    """The solver, restarted from true states.

    Args:
        point: Its settings.
        data: Data file.
        threads: OpenMP threads.
        floor: Name of a floor of chaos that it is.
        moved: Standard deviation of the noise on its starts, particle radii.

    Raises:
        UserError: Its step neither divides the frame interval nor is a multiple of it.
    """

    def __init__(
        self, point: SolverPoint, data: Path, threads: int, floor: str = "", moved: float = 0.0
    ) -> None:
        self.label, self.kind = floor or point.label, "floor" if floor else "solver"
        self._point, self._data, self._threads, self._moved = point, data, threads, moved
        self.paired = point.coarsen == 1
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
        return {**asdict(self._point), "threads": self._threads, "moved": self._moved}

    @property
    def advice(self) -> str:
        point = self._point
        return (
            f'In the scene file of SPlisHSPlasH set "timeStepSize": {point.step:g}, "cflMethod": 0 '
            f'and, in "{point.solver}", "maxError": {point.tolerance:g}'
            + (f", with {point.coarsen:g} times the particle radius." if not self.paired else ".")
        )

    def continued(
        self, reader: FrameReader, simulation: str, runs: Runs, advance: Callable[[], None]
    ) -> Iterator[Continued]:
        point, start = self._point, reader.state(simulation, 0, 1)
        scene = start.scene
        if not self.paired:
            scene = replace(
                scene,
                particle_radius=point.coarsen * scene.particle_radius,
                support_radius=point.coarsen * scene.support_radius,
            )
        job = Replay(
            data=str(self._data.resolve()),
            simulation=simulation,
            solver=point.solver,
            solver_step=point.step,
            tolerance=point.tolerance,
            threads=self._threads,
            runs=runs if self.paired else [(0, runs[-1][1])],
            moved=self._moved * scene.particle_radius,
            coarsen=point.coarsen,
        )
        for run, frame, made in replay(job, advance):
            state = Particles.single(
                torch.from_numpy(made.position),
                torch.from_numpy(made.velocity),
                start.solid_position,
                scene,
            )
            cost = Cost(made.wall, made.cpu, made.setup, made.memory)
            yield Continued(run if self.paired else len(runs) - 1, frame, state, cost)


def floors(data: Path, threads: int) -> list[Solver]:
    """Return the floor of chaos of a file: its own solver, with a moved start and half the step.

    Args:
        data: Data file of scenes that `generate` drew.
        threads: OpenMP threads.
    """
    with h5py.File(data) as file:
        solver: SolverName = file.attrs["solver"]
        used = json.loads(file.attrs["solver_parameters"])
    step, tolerance = float(used["timeStepSize"]), float(used.get("maxError", 1.0))
    return [
        Solver(SolverPoint(solver, step, tolerance), data, threads, "floor: start moved", _MOVED),
        Solver(SolverPoint(solver, step / 2, tolerance), data, threads, "floor: half the step"),
    ]


@final
class ModelSteps(Point):
    """A model in evaluation mode.

    Raises:
        UserError: The model cannot be loaded, its step is no multiple of the frame interval, or
            a prior alone is given a setting of networks.
    """

    def __init__(self, point: ModelPoint, reader: FrameReader, threads: int) -> None:
        self.label, self._point, self._threads = point.name, point, threads
        model = load(point.model, prior=point.prior)
        self.stride = point.stride
        self.kind = "network" if model.network.target.width else "prior alone"
        changed = replace(point, neighbors=None, precision="32-true", compiled=False) != point
        if self.kind != "network" and changed:
            raise UserError(
                f"{point.name} is a prior alone: neighbors, precision and compiled are of networks."
            )
        if step := float(model.time_step):
            self.stride = round(step / reader.header.dt)
            if abs(self.stride * reader.header.dt - step) > 1e-6 * step or not self.stride:
                raise UserError(
                    f"{point.model} has a time step of {step:g} s, which is no multiple of the "
                    f"frame interval, {reader.header.dt:g} s."
                )
        described: Any
        if self.kind == "network":
            # Weights and buffers: a run can be trained anew in its folder.
            described = [float(it.double().sum()) for it in model.state_dict().values()]
        else:
            # Its numbers, too: the config leaves some to their defaults.
            prior = vars(model.prior).items()
            described = {
                "config": config_path(point.model).read_text(encoding="utf-8"),
                "prior": {name: it for name, it in prior if isinstance(it, int | float)},
            }
        self._settings = {**asdict(point), "threads": threads, "described": described}

    @property
    def settings(self) -> dict[str, Any]:
        return self._settings

    @property
    def advice(self) -> str:
        point = self._point
        if point.model.endswith((".yaml", ".yml")):
            changes = "".join(
                f" --model.init_args.prior.init_args.{name} {value}"
                for name, value in point.prior.items()
            )
            return (
                f"fluidsnet predict --config configs/trainer.yaml --config {point.model} --config "
                f"DATA.yaml --data.init_args.stride {self.stride}{changes}"
            )
        return f"fluidsnet predict --run {point.model}"

    @torch.no_grad()
    def continued(
        self, reader: FrameReader, simulation: str, runs: Runs, advance: Callable[[], None]
    ) -> Iterator[Continued]:
        torch.set_num_threads(self._threads)
        began = time.perf_counter()
        with PeakMemory(torch.device("cpu")) as peak:
            model = self._loaded()
            # Compiles its kernels.
            self._step(model, reader.state(simulation, runs[0][0], self.stride))
        setup, memory = time.perf_counter() - began, peak.bytes / 1e6
        for run, (first, frames) in enumerate(runs):
            state = reader.state(simulation, first, self.stride)
            solids = reader.motion(simulation, first, self.stride)
            for step, frame in enumerate(range(self.stride, frames + 1, self.stride), start=1):
                wall, cpu = time.perf_counter(), time.process_time()
                state = self._step(model, state)
                wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
                state = with_solids(state, solids, step)
                cost = Cost(wall / self.stride, cpu / self.stride, setup, memory)
                yield Continued(run, frame, state, cost)
            advance()

    def _loaded(self) -> Model:
        point = self._point
        model = load(point.model, prior=point.prior)
        if point.neighbors is not None:
            model.network.neighbors = type(model.network.neighbors)(point.neighbors)
        if point.compiled:
            compile_network(model.network)
        return model

    def _step(self, model: Model, state: Particles) -> Particles:
        precision = self._point.precision
        if precision == "32-true":
            return model.step(state)
        kind = torch.bfloat16 if precision == "bf16-mixed" else torch.float16
        with torch.autocast(state.position.device.type, dtype=kind):
            return model.step(state)


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
