from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import torch

from fluidsnet.batched import BatchedPrediction
from fluidsnet.integrator import Displacement, Integrator
from fluidsnet.memory import PeakMemory, free_bytes
from fluidsnet.model import Model
from fluidsnet.particles import Particles
from fluidsnet.target import DisplacementTarget, Target, VelocityTarget

Make = Callable[..., Particles]

COUNTS = [(900, 300), (1, 0), (1200, 300), (0, 50), (700, 300), (800, 0), (900, 300)]


def _model(device: torch.device, target: Target, integrator: Integrator | None = None) -> Model:
    torch.manual_seed(0)
    model = Model((6, 4, 6), target=target, integrator=integrator)
    return model.to(device).eval()


@pytest.mark.parametrize("memory", [None, 0, 10**12])
def test_together_they_move_as_alone(
    memory: int | None, make_particles: Make, device: torch.device
) -> None:
    model = _model(device, DisplacementTarget(), Displacement())
    states = [make_particles(count, seed=seed) for seed, count in enumerate(COUNTS)]
    predict = BatchedPrediction(model, device, memory)
    found = list(predict(iter(states)))
    assert sum(predict.batches) == len(states)
    if memory == 0:
        assert predict.batches == [1] * len(states)
    if memory == 10**12:
        assert predict.batches == [1, len(states) - 1]
    for state, after in zip(states, found, strict=True):
        with torch.no_grad():
            alone = model.step(state)
        assert after.solid_position is state.solid_position
        assert torch.allclose(after.velocity, alone.velocity, atol=1e-5)
        assert torch.allclose(after.position, alone.position, atol=1e-5)


def test_batches_keep_within_what_was_measured(make_particles: Make, device: torch.device) -> None:
    states = [make_particles((2000, 500), seed=seed) for seed in range(7)]
    predict = BatchedPrediction(_model(device, VelocityTarget()), device, 10**12)
    list(predict(states))
    # Room for three frames and a half.
    predict.bytes_per_particle = max(predict.bytes_per_particle, 1.0)
    predict.memory = int(3.5 * 2500 * predict.bytes_per_particle)
    next(predict(states))
    assert predict.batches == [3]


def test_states_are_read_as_they_are_needed(make_particles: Make, device: torch.device) -> None:
    read = []

    def states() -> Iterator[Particles]:
        for number in range(4):
            read.append(number)
            yield make_particles((50, 10))

    predict = BatchedPrediction(_model(device, VelocityTarget()), device, 0)
    next(predict(states()))
    assert read == [0, 1]
    assert torch.is_grad_enabled()


def test_other_scenes_do_not_go_together(make_particles: Make, device: torch.device) -> None:
    from dataclasses import replace

    states = [make_particles((50, 10)) for _ in range(3)]
    states[2] = replace(states[2], scene=replace(states[2].scene, support_radius=0.1))
    predict = BatchedPrediction(_model(device, VelocityTarget()), device, 10**12)
    list(predict(states))
    assert predict.batches == [1, 1, 1]
    list(predict(states))
    assert predict.batches == [2, 1]


def test_the_peak_is_what_was_taken_at_once(device: torch.device) -> None:
    peaks = []
    for _ in range(3):
        with PeakMemory(device) as peak:
            for _ in range(3):
                torch.ones(2**24, device=device)
        peaks.append(peak.bytes)
    # Memory that the system had reclaimed, and that a try needs again, adds to it.
    assert 0.9 * 2**26 < min(peaks) < 1.5 * 2**26
    assert free_bytes(device) > 2**26
