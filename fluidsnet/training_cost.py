"""Time and memory of a training step."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import nullcontext
from statistics import median
from typing import Any

import torch
from lightning.pytorch.cli import OptimizerCallable
from lightning.pytorch.plugins.precision import Precision
from torch import Tensor

from fluidsnet.memory import PeakMemory
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

    The models and the random state are not changed. The batch is on the models' device.

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
        steps: dict[str, list[tuple[float, int]]] = {name: [] for name in copies}
        for _ in range(ROUNDS + 1):
            for name, copy in copies.items():
                steps[name].append(_timed(copy, batch, precision))
        for name, copy in copies.items():
            weights = list(copy.parameters())
            state = optimizer(weights)
            kept = _kept_bytes(copy, batch, precision)
            state.step()
            values = (value for moments in state.state.values() for value in moments.values())
            costs[name] = {
                "step_seconds": median(seconds for seconds, _ in steps[name][1:]),
                "kept_bytes": float(kept),
                "parameters": float(sum(weight.numel() for weight in weights)),
                "optimizer_bytes": float(
                    sum(value.nbytes for value in values if isinstance(value, Tensor))
                ),
            }
            if device.type == "cuda":
                costs[name]["peak_bytes"] = float(max(peak for _, peak in steps[name]))
    return costs


def _timed(model: Any, batch: Transitions, precision: Precision) -> tuple[float, int]:
    """Return the seconds of a step, and its additional peak bytes on a GPU."""
    peak = PeakMemory(batch.state.position.device)
    cuda = peak.device.type == "cuda"
    model.zero_grad()
    with peak if cuda else nullcontext():
        started = time.perf_counter()
        _step(model, batch, precision)
        if cuda:
            torch.cuda.synchronize(peak.device)
        seconds = time.perf_counter() - started
    return seconds, peak.bytes


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
