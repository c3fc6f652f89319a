"""Errors of a model's steps from true states, and their score."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass
from typing import final

import torch

from datamodules.reader import FrameReader
from fluidsnet.model import Model
from fluidsnet.particles import Particles, SolidMotion
from fluidsnet.rollout import rollout

#: Errors above this are those of a rollout that blew up, m or m/s.
_MOST = 1e3


@final
@dataclass(frozen=True)
class Errors:
    """Means over true states.

    Attributes:
        one_step: Distance to the true position after one step, m.
        two_steps: The same after two.
        velocity: Root mean square error of the velocity after one step, m/s.
        rollout: Distance to the true position at the end of a rollout, m.
    """

    one_step: float
    two_steps: float
    velocity: float
    rollout: float

    @property
    def score(self) -> float:
        """Mean logarithm of the errors, so that each counts by its relative change."""
        values = list(asdict(self).values())
        return sum(math.log(max(min(value, _MOST), 1e-12)) for value in values) / len(values)


@final
class Objective:
    """Errors of a model on states of a data file, which are read once.

    Args:
        reader: Reader of the data file.
        simulations: Names of the simulations.
        samples: Number of true states of each that two steps start from, evenly spaced.
        steps: Steps of a rollout of each, from its first frame.
        stride: Frames in a step.
    """

    def __init__(
        self,
        reader: FrameReader,
        simulations: list[str],
        samples: int,
        steps: int,
        stride: int,
    ) -> None:
        self._near: list[list[Particles]] = []
        self._far: list[tuple[Particles, int, Particles, SolidMotion | None]] = []
        for name in simulations:
            last = reader.frames[name] - 1
            starts = {round(k / samples * (last - 2 * stride)) for k in range(1, samples + 1)}
            self._near += [
                [reader.state(name, start + k * stride, stride) for k in range(3)]
                for start in sorted(starts)
            ]
            reached = min(steps, last // stride)
            end = reader.state(name, reached * stride, stride)
            start, solids = reader.state(name, 0, stride), reader.motion(name, 0, stride)
            self._far.append((start, reached, end, solids))

    @torch.no_grad()
    def __call__(self, model: Model) -> Errors:
        """Return the errors of a model; infinite where it leaves the finite numbers."""
        rows = []
        for start, true, later in self._near:
            first = model.step(start)
            second = model.step(first.with_solids_of(true))
            velocity = (first.velocity - true.velocity).square().sum(dim=1).mean()
            rows.append(torch.stack([_distance(first, true), _distance(second, later), velocity]))
        one, two, square = torch.stack(rows).mean(dim=0).tolist()
        ends = []
        for start, steps, true, solids in self._far:
            (end,) = deque(rollout(model, start, steps, solids), maxlen=1)
            ends.append(_distance(end, true))
        far = float(torch.stack(ends).mean())
        errors = (one, two, math.sqrt(square), far)
        return Errors(*(math.inf if math.isnan(error) else error for error in errors))


def _distance(state: Particles, true: Particles) -> torch.Tensor:
    distance: torch.Tensor = torch.linalg.vector_norm(state.position - true.position, dim=1)
    return distance.mean()
