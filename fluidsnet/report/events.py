"""What a run logged to TensorBoard."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fluidsnet.report.event_file import EventFile, read_event_file

PATTERN = "events.out.tfevents.*"

TRAINED = "train/loss"
#: The learning rate, with twins one of each model.
RATE = "train/learning_rate"

#: Groups of what a training logs at its own steps; one that is resumed may log others at step 0,
#: such as Lightning's `hp_metric`.
_OF_TRAINING = ("train/", "val/", "ablation/")

Curve = tuple[tuple[int, float], ...]


@dataclass
class History:
    """A training's scalars.

    Attributes:
        curves: by tag, (step, value) in the order of the steps.
        seconds: from the first value that training logged to the last, over all sessions.
        unread: sentences, one for each file that is not whole or cannot be read.
    """

    curves: dict[str, Curve] = field(default_factory=dict)
    seconds: float = 0.0
    unread: list[str] = field(default_factory=list)


def read_history(folder: Path) -> History:
    """Reads the event files of a run's training.

    Each session of a run has its own file. Where training was resumed or repeated in the same
    folder, the later session's values replace the earlier one's from the first step on that it
    logged. Sessions without a training loss and without anything above step 0 did not train.

    Args:
        folder: of the run.
    """
    history = History()
    files: list[EventFile] = []
    for path in sorted(folder.glob(PATTERN)):
        try:
            files.append(read_event_file(path))
        except OSError as error:
            history.unread.append(f"{path.name} cannot be read: {error.strerror}.")
    history.unread += [file.flaw for file in files if file.flaw]
    for file in sorted(files, key=lambda file: file.began):
        steps = {
            scalar.step
            for tag, scalars in file.scalars.items()
            if tag.startswith(_OF_TRAINING)
            for scalar in scalars
        }
        if TRAINED not in file.scalars and not any(steps):
            continue
        begin = min(steps)
        times = [scalar.time for scalars in file.scalars.values() for scalar in scalars]
        history.seconds += max(times) - min(times)
        history.curves = {
            tag: tuple(point for point in curve if point[0] < begin)
            for tag, curve in history.curves.items()
        }
        for tag, scalars in file.scalars.items():
            points = dict(history.curves.get(tag, ()))
            points.update((scalar.step, scalar.value) for scalar in scalars)
            history.curves[tag] = tuple(sorted(points.items()))
    history.curves = {tag: curve for tag, curve in history.curves.items() if curve}
    return history


def finite(curve: Curve) -> list[float]:
    """The values of a curve that are finite."""
    return [value for _, value in curve if math.isfinite(value)]


def tags(histories: Sequence[History], beginning: str) -> list[str]:
    """Names of the curves of any run that begin so, in alphabetical order."""
    return sorted({tag for it in histories for tag in it.curves if tag.startswith(beginning)})
