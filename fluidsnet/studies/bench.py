"""How a network is measured, inside a process of its own."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile

from datamodules.reader import FrameReader
from fluidsnet import kernels
from fluidsnet.batched import BatchedPrediction
from fluidsnet.compiled import compile_network
from fluidsnet.memory import PeakMemory
from fluidsnet.module import FluidsNet
from fluidsnet.particles import Particles
from fluidsnet.studies.cores import measure_cores
from fluidsnet.studies.model import load_model
from fluidsnet.studies.trial import STAGES, Result, Trial


class _Bench:
    """A network and the state it steps."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self.device = torch.device(trial.device)
        reader = FrameReader(Path(trial.states))
        scene = reader.scene(1)
        name, frames = next(iter(reader.frames.items()))
        count = trial.batch if trial.kind == "batch" else 1
        self.states = [reader.state(name, frame, scene) for frame in range(frames - count, frames)]
        self.module: FluidsNet = load_model(
            trial.model, trial.run, trial.neighbors, scene.time_step
        ).to(self.device)
        if trial.compile:
            compile_network(self.module.model.network)

    def precision(self) -> contextlib.AbstractContextManager[Any]:
        """Autocast, where it is asked for."""
        if self.trial.precision == "float32":
            return contextlib.nullcontext()
        return torch.autocast(self.device.type, dtype=getattr(torch, self.trial.precision))

    def step(self, state: Particles | None = None) -> Tensor:
        """The next velocities, (N, 3), after a whole step and with all copies."""
        with torch.no_grad(), self.precision():
            start = (self.states[-1] if state is None else state).to(self.device)
            after = self.module(start)
            after.position.cpu()
            velocity: Tensor = after.velocity.cpu()
            return velocity

    def search(self) -> Any:
        """The edges of the state."""
        with torch.no_grad():
            found = self.module.model.network.neighbors(self.states[-1].to(self.device))
            _wait(self.device)
            return found

    def few(self) -> Particles:
        """A part of the state, to load on what is compiled and what is loaded late."""
        state = self.states[-1]
        return Particles.single(
            state.position[:200], state.velocity[:200], state.solid_position[:200], state.scene
        )


def measure(trial: Trial) -> Result:
    """Does what a trial says.

    Raises:
        UserError: the model or the states cannot be used.
    """
    torch.set_num_threads(trial.threads)
    if trial.kind == "cores":
        return Result(cores=measure_cores(trial.threads))
    bench = _Bench(trial)
    bench.step(bench.few())
    if trial.kind == "reference":
        with kernels.disabled():
            np.save(trial.reference, bench.step().numpy())
        return Result()
    return _batch(bench) if trial.kind == "batch" else _step(bench)


def _step(bench: _Bench) -> Result:
    trial, began = bench.trial, time.perf_counter()
    if trial.compile:
        # Compiling takes memory of its own.
        bench.step()
    with PeakMemory(bench.device) as peak:
        velocity = bench.step()
    result = Result(
        step=_timed(bench.step, trial.repeats, trial.seconds / 2),
        stages=_stages(bench, 3),
        peak=peak.bytes,
        error=_error(velocity, trial.reference),
        solids=len(bench.states[-1].solid_position),
    )
    if trial.precision != "float32" or trial.compile:
        # The search knows neither.
        return result
    neighbors = bench.search()
    left = trial.seconds - (time.perf_counter() - began)
    return replace(
        result,
        search=_timed(bench.search, trial.repeats, max(left, 0.0)),
        edges=len(neighbors.particle) / len(bench.states[-1]),
    )


def _batch(bench: _Bench) -> Result:
    trial = bench.trial
    predict = BatchedPrediction(bench.module.model.network, bench.device)

    def work() -> None:
        with bench.precision():
            for motion in predict(bench.states):
                motion.velocity.cpu()

    work()
    seconds = _timed(work, trial.repeats, trial.seconds)
    with PeakMemory(bench.device) as peak:
        work()
    return Result(
        step=seconds,
        batches=predict.batches,
        peak=peak.bytes,
        solids=len(bench.states[-1].solid_position),
    )


def _timed(work: Callable[[], Any], repeats: int, most: float) -> list[float]:
    """S of each repeat; as many as asked for, more of what is short, fewer of what is long."""
    seconds: list[float] = []
    while not seconds or (
        (len(seconds) < repeats or sum(seconds) < 0.2) and sum(seconds) + seconds[-1] < most
    ):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return seconds


def _stages(bench: _Bench, repeats: int) -> dict[str, float]:
    """S of each stage: the median of some steps under the profiler."""
    activities = [ProfilerActivity.CPU]
    if bench.device.type == "cuda":
        activities.append(ProfilerActivity.CUDA)
    found: dict[str, list[float]] = {}
    for _ in range(repeats):
        with profile(activities=activities) as profiler:
            bench.step()
        for event in profiler.key_averages():
            if event.key in STAGES:
                # Of a GPU its own time, since the CPU only sends it work.
                on_gpu = bench.device.type == "cuda"
                spent = event.device_time_total if on_gpu else event.cpu_time_total
                found.setdefault(event.key, []).append(spent * 1e-6)
    if "search" in found:
        # Asked for cells, such a search has none to give.
        found.pop("sort", None)
    return {name: float(np.median(seconds)) for name, seconds in found.items()}


def _error(velocity: Tensor, reference: str) -> float | None:
    if not reference or not Path(reference).exists():
        return None
    truth = np.load(reference)
    scale = float(np.sqrt(np.square(truth, dtype=np.float64).sum(axis=1).mean()))
    return float(np.linalg.norm(velocity.float().numpy() - truth, axis=1).mean()) / scale


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
