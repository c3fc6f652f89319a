"""One finished training of a study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class TrainedRun:
    """One finished training, with its twins.

    Attributes:
        scene: its name.
        stride: frames of the data a step of the network.
        seed: of the weights and of the batches' order.
        folder: the run's, tested.
    """

    scene: str
    stride: int
    seed: int
    folder: Path
