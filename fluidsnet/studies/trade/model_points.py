"""Models as points of the trade study."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from typing import Any, final

import torch

from datamodules.reader import FrameReader
from fluidsnet.compiled import compile_network
from fluidsnet.errors import UserError
from fluidsnet.memory import PeakMemory
from fluidsnet.model import Model
from fluidsnet.models import config_path, load
from fluidsnet.particles import Particles
from fluidsnet.rollout import with_solids
from fluidsnet.studies.trade.options import ModelPoint
from fluidsnet.studies.trade.points import Continued, Cost, Point, Runs


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
