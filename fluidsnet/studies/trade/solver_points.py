"""The solver as a point of the trade study, and the floor of chaos."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, final

import h5py
import torch

from datamodules.generate.job import SolverName
from datamodules.generate.replay import Replay, replay
from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.particles import Particles
from fluidsnet.studies.trade.options import SolverPoint
from fluidsnet.studies.trade.points import Continued, Cost, Point, Runs

# Noise on the start of the floor of chaos, particle radii.
_MOVED = 1e-3


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
