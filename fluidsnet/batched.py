"""Batched prediction of known frames (paper, section 5.5), as many at once as memory allows.

The frames of a rollout cannot be batched, since each needs the one before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import final

import torch

from fluidsnet.memory import PeakMemory, free_bytes
from fluidsnet.model import Model
from fluidsnet.particles import Particles


@final
class BatchedPrediction:
    """Predict the state one step after each frame, in batches that fit into memory.

    The first frame is a batch alone. Its peak memory per particle, fluid and solid, limits the
    size of the next batches; a larger batch updates it. A frame is never split, so a frame that
    is too large alone runs out of memory.

    Args:
        model: Model in evaluation mode.
        device: Device of the model. Frames are copied to it, and predictions back.
        memory: Memory for a batch, bytes; by default half of what is free when a call begins.
    """

    def __init__(
        self, model: Model, device: torch.device | str = "cpu", memory: int | None = None
    ) -> None:
        self.model, self.device, self.memory = model, torch.device(device), memory
        #: Frames in each batch of the last call.
        self.batches: list[int] = []
        #: Peak memory per particle of the largest batch so far.
        self.bytes_per_particle = 0.0
        self._largest = 0

    def __call__(self, states: Iterable[Particles]) -> Iterator[Particles]:
        """Yield the next state of each state, in order.

        Args:
            states: States of one or more frames each, read when they are needed. Only states
                in boxes of the same edges share a batch.
        """
        memory = free_bytes(self.device) // 2 if self.memory is None else self.memory
        self.batches = []
        waiting: list[Particles] = []
        for state in states:
            if waiting and not self._fits([*waiting, state], memory):
                yield from self._predict(waiting)
                waiting = []
            waiting.append(state)
        if waiting:
            yield from self._predict(waiting)

    def _fits(self, states: Sequence[Particles], memory: int) -> bool:
        needed = sum(map(_count, states)) * self.bytes_per_particle
        joins = states[-1].scene.joins(states[0].scene)
        return self._largest > 0 and joins and needed <= memory

    # Not around the generator, whose caller may need gradients between two states.
    @torch.no_grad()
    def _predict(self, states: Sequence[Particles]) -> list[Particles]:
        with PeakMemory(self.device) as peak:
            after = self.model.step(Particles.collate(states).to(self.device))
            origin, sizes = states[0].position.device, list(map(len, states))
            position = torch.split(after.position.to(origin), sizes)
            velocity = torch.split(after.velocity.to(origin), sizes)
        self.batches.append(sum(state.frames for state in states))
        count = sum(map(_count, states))
        if count >= self._largest:
            self._largest, self.bytes_per_particle = count, peak.bytes / max(count, 1)
        moves = zip(states, position, velocity, strict=True)
        return [state.moved(*move) for state, *move in moves]


def _count(state: Particles) -> int:
    """Return the number of fluid and solid particles."""
    return len(state) + len(state.solid_position)
