"""Measure a network or the processor; the measuring process of `run_trial`."""

from __future__ import annotations

import os
import pickle
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile

import fluidsnet.neighbors
from datamodules.reader import FrameReader
from fluidsnet import kernels
from fluidsnet.batched import BatchedPrediction
from fluidsnet.compiled import compile_network
from fluidsnet.errors import UserError
from fluidsnet.memory import PeakMemory, free_bytes
from fluidsnet.model import Model
from fluidsnet.models import load
from fluidsnet.models.loading import build
from fluidsnet.particles import Particles
from fluidsnet.studies.dam_break import CELLS
from fluidsnet.studies.speed.floor import measure_cores
from fluidsnet.studies.speed.trial import Result, SpeedOptions, Trial

#: Profiler ranges of a step, as `Network.forward` names them.
STAGES = ("sort", "search", "search + local", "local", "voxel", "global", "head")


def load_model(options: SpeedOptions, neighbors: str) -> Model:
    """Return the network of the options in evaluation mode, with a class of neighbor search.

    Without a run its weights are random, and without a config it is the paper's.

    Raises:
        UserError: A file is missing or not valid, or the run was trained at another time step.
    """
    torch.manual_seed(0)
    if options.run is not None:
        model = load(options.run)
        trained = float(model.time_step)
        if abs(trained - options.time_step) > 1e-6 * trained:
            raise UserError(
                f"{options.run} was trained at a time step of {trained:g} s, not "
                f"{options.time_step:g} s; add --time_step {trained:g}."
            )
    elif options.model is not None:
        model = build(Path(options.model), CELLS).model
    else:
        model = Model(CELLS)
    network = model.network
    network.neighbors = getattr(fluidsnet.neighbors, neighbors)(network.neighbors.k)
    return model.eval()


def measure(trial: Trial) -> Result:
    """Carry out a trial in this process.

    Raises:
        UserError: The model or the states cannot be used.
    """
    torch.set_num_threads(trial.options.threads)
    if trial.kind == "cores":
        return Result(cores=measure_cores())
    bench = _Bench(trial)
    bench.warm_up()
    if trial.kind == "reference":
        with kernels.disabled():
            np.save(trial.reference, bench.step().numpy())
        return Result()
    result = bench.measure_batch() if trial.kind == "batch" else bench.measure_step()
    result.solids = len(bench.states[-1].solid_position)
    return result


class _Bench:
    """A network and the states that it steps."""

    def __init__(self, trial: Trial) -> None:
        self.trial, options = trial, trial.options
        self.device = torch.device(options.device)
        reader = FrameReader(trial.states)
        name, frames = next(iter(reader.frames.items()))
        count = options.batch if trial.kind == "batch" else 1
        self.states = [
            reader.state(name, frame, stride=1) for frame in range(frames - count, frames)
        ]
        self.model = load_model(options, trial.neighbors).to(self.device)
        if trial.compile:
            compile_network(self.model.network)

    def warm_up(self) -> None:
        """Step a part of the state, so that all kernels are compiled and libraries loaded."""
        state = self.states[-1]
        parts = (state.position[:200], state.velocity[:200], state.solid_position[:200])
        self.step(Particles.single(*parts, state.scene))

    def autocast(self) -> torch.autocast:
        """Return the context of the trial's precision."""
        name = self.trial.precision
        return torch.autocast(self.device.type, getattr(torch, name), enabled=name != "float32")

    def step(self, state: Particles | None = None) -> Tensor:
        """Return the next velocities (N, 3), m/s, on the CPU, with all copies included."""
        with torch.no_grad(), self.autocast():
            after = self.model.step((self.states[-1] if state is None else state).to(self.device))
            after.position.cpu()
            return after.velocity.cpu()

    def search(self) -> Any:
        """Return the edges of the state."""
        with torch.no_grad():
            neighbors = self.model.network.neighbors(self.states[-1].to(self.device))
            if self.device.type == "cuda":
                torch.cuda.synchronize(self.device)
        return neighbors

    def measure_step(self) -> Result:
        """Measure time, stages, memory and error of a step, and the time of a search."""
        trial, options, began = self.trial, self.trial.options, time.perf_counter()
        if trial.compile:
            # Compilation itself takes memory.
            self.step()
        with PeakMemory(self.device) as peak:
            velocity = self.step()
        result = Result(
            step=_repeat(self.step, options.repeats, options.seconds / 2),
            stages=self._stages(3),
            peak=peak.bytes,
            error=_error(velocity, trial.reference),
        )
        # The search does not depend on precision and compilation.
        if trial.precision == "float32" and not trial.compile:
            result.edges = len(self.search().particle) / len(self.states[-1])
            remaining = options.seconds - (time.perf_counter() - began)
            result.search = _repeat(self.search, options.repeats, remaining)
        return result

    def measure_batch(self) -> Result:
        """Measure time and memory of all states predicted at once."""
        options = self.trial.options
        predict = BatchedPrediction(self.model, self.device)

        def work() -> None:
            with self.autocast():
                for _ in predict(self.states):
                    pass

        work()
        seconds = _repeat(work, options.repeats, options.seconds)
        with PeakMemory(self.device) as peak:
            work()
        return Result(step=seconds, batches=predict.batches, peak=peak.bytes)

    def _stages(self, repeats: int) -> dict[str, float]:
        """Return the median time of each stage under the profiler, s."""
        on_gpu = self.device.type == "cuda"
        activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if on_gpu else [])]
        times: dict[str, list[float]] = {}
        for _ in range(repeats):
            with profile(activities=activities) as profiler:
                self.step()
            for event in profiler.key_averages():
                if event.key in STAGES:
                    # On a GPU the CPU only launches the kernels.
                    spent = event.device_time_total if on_gpu else event.cpu_time_total
                    times.setdefault(event.key, []).append(spent * 1e-6)
        if "search" in times:
            # The range `sort` of a search with edges covers no sorting.
            times.pop("sort", None)
        return {name: float(np.median(seconds)) for name, seconds in times.items()}


def _repeat(work: Callable[[], Any], repeats: int, limit: float) -> list[float]:
    """Time repeats of a call, s: more where they last under 0.2 s, fewer where beyond the limit."""
    seconds: list[float] = []
    while not seconds or (
        (len(seconds) < repeats or sum(seconds) < 0.2) and sum(seconds) + seconds[-1] < limit
    ):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return seconds


def _error(velocity: Tensor, reference: Path) -> float | None:
    if not reference.is_file():
        return None
    truth = np.load(reference)
    scale = float(np.sqrt(np.square(truth, dtype=np.float64).sum(axis=1).mean()))
    return float(np.linalg.norm(velocity.float().numpy() - truth, axis=1).mean()) / scale


def main() -> None:
    """Read a trial from stdin, carry it out and write its result to stdout."""
    answer = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # What libraries print must not get into the answer.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    trial: Trial = pickle.load(sys.stdin.buffer)
    if sys.platform == "linux" and trial.options.device == "cpu":
        # Lets an allocation beyond the free memory fail before the machine runs out of it.
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        limit = int(0.9 * free_bytes(torch.device("cpu")))
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    try:
        result = measure(trial)
    except UserError as error:
        result = Result(failure=f"{error}")
    except (MemoryError, RuntimeError) as error:
        out_of_memory = isinstance(error, MemoryError | torch.OutOfMemoryError)
        if not out_of_memory and "allocate" not in str(error):
            raise
        result = Result(failure="out of memory")
    with answer:
        pickle.dump(result, answer)
