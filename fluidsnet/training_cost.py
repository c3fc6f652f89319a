"""Time and memory of a training step."""

from __future__ import annotations

import time
from collections.abc import Mapping
from statistics import median
from typing import Any

import torch
from lightning.pytorch.cli import OptimizerCallable
from lightning.pytorch.plugins.precision import Precision
from torch import Tensor

from fluidsnet.model import Model
from fluidsnet.particles import Transitions
from fluidsnet.rng import preserve_rng_state

#: Timed steps of each model, after one warm-up step.
ROUNDS = 3


def training_costs(
    models: Mapping[str, Model],
    batch: Transitions,
    optimizer: OptimizerCallable,
    precision: Precision,
) -> dict[str, dict[str, float]]:
    """Measure training steps of copies of the models, in turns, so that load affects all alike.

    The models and the random state are not changed.

    Args:
        models: Models by name.
        batch: Batch of the steps, on the models' device.
        optimizer: Builds the optimizer from weights.
        precision: Lightning's precision plugin of the run.

    Returns:
        For each model ``step_seconds``, the median time of forward and backward pass with
        neighbor search; ``kept_bytes``, of tensors saved for the backward pass; ``peak_bytes``,
        the additional peak memory on a CUDA GPU; ``parameters``, their number;
        ``optimizer_bytes``, of the optimizer's state.
    """
    device = batch.state.position.device
    costs = {}
    with preserve_rng_state(device):
        copies = {
            name: precision.convert_module(model.twin().to(device).train())
            for name, model in models.items()
        }
        seconds: dict[str, list[float]] = {name: [] for name in copies}
        peaks = dict.fromkeys(copies, 0.0)
        for round_ in range(ROUNDS + 1):
            for name, copy in copies.items():
                taken, peak = _timed(copy, batch, precision)
                if round_:
                    seconds[name].append(taken)
                peaks[name] = max(peaks[name], peak)
        for name, copy in copies.items():
            weights = list(copy.parameters())
            state = optimizer(weights)
            kept = _kept_bytes(copy, batch, precision)
            state.step()
            costs[name] = {
                "step_seconds": median(seconds[name]),
                "kept_bytes": float(kept),
                "parameters": float(sum(weight.numel() for weight in weights)),
                "optimizer_bytes": float(_bytes_in(state.state)),
            }
            if device.type == "cuda":
                costs[name]["peak_bytes"] = peaks[name]
    return costs


def _timed(model: Any, batch: Transitions, precision: Precision) -> tuple[float, float]:
    """Return the seconds of a step, and its additional peak bytes on a GPU."""
    device = batch.state.position.device
    cuda, before, peak = device.type == "cuda", 0, 0
    model.zero_grad()
    if cuda:
        torch.cuda.synchronize(device)
        before = torch.cuda.memory_allocated(device)
        torch.cuda.reset_peak_memory_stats(device)
    started = time.perf_counter()
    _step(model, batch, precision)
    if cuda:
        torch.cuda.synchronize(device)
        peak = torch.cuda.max_memory_allocated(device)
    return time.perf_counter() - started, float(peak - before)


def _step(model: Any, batch: Transitions, precision: Precision) -> None:
    with precision.train_step_context():
        loss: Tensor = model.loss(batch)
    loss.backward()  # type: ignore[no-untyped-call]


def _kept_bytes(model: Any, batch: Transitions, precision: Precision) -> int:
    """Return the bytes saved for the backward pass, each storage counted once."""
    weights = {weight.untyped_storage().data_ptr() for weight in model.parameters()}
    sizes: dict[int, int] = {}

    def pack(value: Tensor) -> Tensor:
        storage = value.untyped_storage()
        if storage.data_ptr() not in weights:
            sizes[storage.data_ptr()] = storage.nbytes()
        return value

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda value: value):
        _step(model, batch, precision)
    return sum(sizes.values())


def _bytes_in(state: Mapping[Any, Any]) -> int:
    return sum(
        value.numel() * value.element_size()
        for values in state.values()
        for value in values.values()
        if isinstance(value, Tensor)
    )
