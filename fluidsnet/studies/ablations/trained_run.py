"""One training of a study: which it is, and where."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class TrainedRun:
    """A training with its twins, whether it has run or not.

    Attributes:
        scene: its name.
        stride: frames of the data a step of the network.
        seed: of the weights and of the batches' order.
        folder: where it lies once it is trained and tested.
    """

    scene: str
    stride: int
    seed: int
    folder: Path
