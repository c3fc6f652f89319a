"""Errors and cost of a point in one simulation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import fmean
from typing import final

import torch

from datamodules.reader import FrameReader
from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.metrics.misplaced_volume import MisplacedVolume
from fluidsnet.metrics.suite import FIELD_METRICS, METRICS, RolloutSuite
from fluidsnet.particles import Particles
from fluidsnet.studies.trade.options import TradeOptions
from fluidsnet.studies.trade.points import Cost, Point, Runs

#: What is measured of a rollout after some frames: name of the metric, and of the result.
_ROLLOUT = {
    "position_error_mm": "rollout_mm",
    "misplaced_volume": "misplaced",
    "chamfer_mm": "chamfer_mm",
    "kinetic_energy": "energy_error",
    "density_error": "density_error",
    "escaped": "escaped",
    "non_finite": "non_finite",
}


@final
@dataclass(frozen=True)
class Measured:
    """Results of one simulation.

    Attributes:
        fluid: Number of fluid particles of the truth.
        wall: Mean wall time for a frame, s; from true states, or along the rollout of a point
            that has no others.
        cpu: Mean time of all cores for it, s.
        setup: Wall time before the first step, s.
        memory: Most memory in use beyond that before the set-up, MB.
        values: Values by result and number of frames; NaN after frames that a point has no state
            for.
        others: Cores that other processes kept busy meanwhile.
    """

    fluid: int
    wall: float
    cpu: float
    setup: float
    memory: float
    values: dict[str, dict[int, float]]
    others: float = 0.0


@torch.no_grad()
def measure(
    point: Point,
    reader: FrameReader,
    simulation: str,
    options: TradeOptions,
    advance: Callable[[], None],
) -> Measured:
    """Continue true states of a simulation and measure what came out.

    Args:
        point: Point.
        reader: Reader of the data file.
        simulation: Name of the simulation.
        options: What to measure.
        advance: Called now and then meanwhile.
    """
    known = reader.frames[simulation] - 1
    horizon, steps = min(options.horizon, known), min(options.steps, known)
    short: Runs = [(first, horizon) for first in range(1, known - horizon + 1, options.every)]
    runs: Runs = [*(short or [(0, horizon)]), (0, steps)]
    last = len(runs) - 1
    device, kinds = torch.device("cpu"), METRICS if point.paired else FIELD_METRICS
    near = RolloutSuite([0] * last, horizon, (), device)
    far = RolloutSuite([0], steps, options.marks, device, kinds=(*kinds, MisplacedVolume))
    starts = [reader.state(simulation, first, 1) for first, _ in runs]

    def add(run: int, frame: int, state: Particles) -> None:
        start = starts[run]
        true = reader.state(simulation, runs[run][0] + frame, 1)
        if run == last:
            far.update(0, frame, {"model": state}, true, start)
        else:
            trivial = {name: it(start, frame) for name, it in TRIVIAL_PREDICTORS.items()}
            near.update(run, frame, {"model": state, **trivial}, true, start)

    missing = {
        (run, frame)
        for run, (_, frames) in enumerate(runs)
        for frame in range(point.stride, frames + 1, point.stride)
        if point.paired or run == last
    }
    costs: list[Cost] = []
    for made in point.continued(reader, simulation, runs, advance):
        missing.discard((made.run, made.frame))
        add(made.run, made.frame, made.state)
        if made.run < last or not point.paired:
            costs.append(made.cost)
    for run, frame in sorted(missing):
        # The solver ended: its errors are infinite from there on.
        lost = torch.full_like(starts[run].position, torch.nan)
        add(run, frame, starts[run].moved(lost, lost))
    rolled = far.compute()["model"]
    values = _near(near, horizon) if point.paired else {}
    marks = [mark for mark in options.marks if mark <= steps]
    values |= {
        result: {mark: float(rolled[metric][mark - 1]) for mark in marks}
        for metric, result in _ROLLOUT.items()
        if metric in rolled
    }
    return Measured(
        fluid=len(starts[0]),
        wall=fmean(cost.wall for cost in costs),
        cpu=fmean(cost.cpu for cost in costs),
        setup=costs[0].setup,
        memory=max((cost.memory for cost in costs), default=math.nan),
        values=values,
    )


def _near(suite: RolloutSuite, horizon: int) -> dict[str, dict[int, float]]:
    """Return the errors from true states after each frame."""
    errors = suite.compute()
    frames = range(1, horizon + 1)
    distance = errors["model"]["position_error_mm"]
    return {
        "error_mm": {frame: float(distance[frame - 1]) for frame in frames},
        "skill": {frame: _skill(errors, frame) for frame in frames},
    }


def _skill(errors: dict[str, dict[str, torch.Tensor]], frame: int) -> float:
    """Return 1 less the error of the velocity over that of the better trivial predictor."""
    own, *trivial = (
        float(errors[name]["velocity_mse"][frame - 1]) for name in ("model", *TRIVIAL_PREDICTORS)
    )
    return 1 - own / min(trivial)
