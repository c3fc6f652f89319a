"""Time and memory of the parts of a step."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any, final

import torch

from fluidsnet.memory import PeakMemory
from fluidsnet.model import Model
from fluidsnet.particles import Particles


@final
@dataclass(frozen=True)
class Cost:
    """Cost of a part.

    Attributes:
        seconds: Median wall time, s.
        bytes: Peak memory beyond that before, bytes.
    """

    seconds: float
    bytes: int


@torch.no_grad()
def measure_costs(model: Model, state: Particles, repeats: int = 5) -> dict[str, Cost]:
    """Measure the parts of a step one after another.

    Args:
        model: Model in evaluation mode, on the device of the state.
        state: Particles to step.
        repeats: Number of times that each part is timed, after one that is not.

    Returns:
        Costs of "prior", "inputs", "local" with the neighbor search, "global", "head", "motion"
        with integrator and walls, and of the whole "step".
    """
    network, guess = model.network, model.guess(state)
    work: dict[str, Callable[[], Any]] = {"prior": lambda: model.guess(state)}
    if network.target.width:
        columns = network.inputs(state, guess)
        features = network.features(state, guess)
        vector = network.global_feature(state, features)
        work |= {
            "inputs": lambda: network.inputs(state, guess),
            "local": lambda: network.neighborhood(state, guess, columns),
            "global": lambda: network.global_feature(state, features),
            "head": lambda: network.head(features, vector),
        }
    output = network(state, guess)
    work["motion"] = lambda: model.advance(state, guess, output)
    work["step"] = lambda: model.step(state)
    return _costs(work, state.position.device, repeats)


def _costs(
    work: Mapping[str, Callable[[], Any]], device: torch.device, repeats: int
) -> dict[str, Cost]:
    """Measure calls by turns, so that what else the machine does spoils none of them alone."""

    def run(name: str) -> float:
        began = time.perf_counter()
        work[name]()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        return time.perf_counter() - began

    memory: dict[str, int] = {}
    for name in work:
        run(name)
        with PeakMemory(device) as peak:
            run(name)
        memory[name] = peak.bytes
    seconds = [{name: run(name) for name in work} for _ in range(repeats)]
    return {name: Cost(median(it[name] for it in seconds), memory[name]) for name in work}
