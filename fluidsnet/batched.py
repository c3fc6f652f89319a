"""Many frames predicted at once (paper, section 5.5), as many as the memory holds.

Each prediction starts from a frame that is known, so the frames do not wait for each other; in
a rollout they do, and nothing is gained.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import final

import torch
from torch import Tensor

from fluidsnet.memory import PeakMemory, free_bytes
from fluidsnet.network import Network
from fluidsnet.particles import Particles
from fluidsnet.target import Motion


@final
class BatchedPrediction:
    """Groups whole frames into batches that fit, and yields the motion of each frame.

    The first frame goes alone, and the memory that it takes at its peak says how many
    particles, fluid and solid, a batch may have. Each batch is measured, and the largest one
    decides. A frame is never cut: one that does not fit alone fails as it would without this.

    Args:
        network: in evaluation mode.
        device: of the network; frames are copied there, and motions back to where they were.
        memory: bytes that a batch may take beyond what is there; half of what is free when a
            call begins by default.
    """

    def __init__(
        self, network: Network, device: torch.device | str = "cpu", memory: int | None = None
    ) -> None:
        self.network, self.device, self.memory = network, torch.device(device), memory
        #: Frames in each batch of the last call.
        self.batches: list[int] = []
        #: What a particle took in the largest batch so far, and how many were in it.
        self.bytes_per_particle = 0.0
        self._largest = 0

    def __call__(self, states: Iterable[Particles]) -> Iterator[Motion]:
        """The motion of each state, in their order.

        Args:
            states: one or more frames each; read as they are needed. Only those that share
                their scene (the same object) go together.
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
        if not self._largest or states[-1].scene is not states[0].scene:
            return False
        return sum(map(_count, states)) * self.bytes_per_particle <= memory

    # Around the prediction alone: the caller's own gradients are not this generator's to stop.
    @torch.no_grad()
    def _predict(self, states: Sequence[Particles]) -> list[Motion]:
        with PeakMemory(self.device) as peak:
            batch = Particles.collate(states).to(self.device)
            motion = self.network.motion(batch)
            home = states[0].position.device
            sizes = [len(state) for state in states]
            velocity = motion.velocity.to(home).split(sizes)  # type: ignore[no-untyped-call]
            displacement: Sequence[Tensor | None] = [None] * len(states)
            if motion.displacement is not None:
                displacement = motion.displacement.to(home).split(sizes)  # type: ignore[no-untyped-call]
        self.batches.append(sum(state.frames for state in states))
        count = sum(map(_count, states))
        if count >= self._largest:
            self._largest, self.bytes_per_particle = count, peak.bytes / max(count, 1)
        return [Motion(*pair) for pair in zip(velocity, displacement, strict=True)]


def _count(state: Particles) -> int:
    """Fluid and solid particles."""
    return len(state) + len(state.solid_position)
