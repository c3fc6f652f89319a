"""What a run logged to TensorBoard."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

PATTERN = "events.out.tfevents.*"

#: A session that logged this trained; others tested, or validated a checkpoint once.
TRAINED = "train/loss"
#: The learning rate, with twins one of each model.
RATE = "train/learning_rate"

Curve = tuple[tuple[int, float], ...]


@dataclass
class History:
    """A training's scalars.

    Attributes:
        curves: by tag, (step, value) in the order of the steps.
        seconds: from the first value that training logged to the last, over all sessions.
        unread: of each file that could not be read, its name.
    """

    curves: dict[str, Curve] = field(default_factory=dict)
    seconds: float = 0.0
    unread: list[str] = field(default_factory=list)


def read_history(folder: Path) -> History:
    """Reads the event files of a run's training.

    Each session of a run has its own file. Where training was resumed or repeated in the same
    folder, the later session's values replace the earlier one's from its first step on.

    Args:
        folder: of the run.
    """
    history = History()
    for path in sorted(folder.glob(PATTERN)):
        try:
            scalars = _scalars(path)
        except Exception:  # a damaged file fails in as many ways as its format has parts
            history.unread.append(path.name)
            continue
        if TRAINED not in scalars:
            continue
        # The ablation's costs are measured before the first step and logged at step 0.
        begin = min(event.step for event in scalars[TRAINED])
        times = [event.wall_time for events in scalars.values() for event in events]
        history.seconds += max(times) - min(times)
        history.curves = {
            tag: tuple(point for point in curve if point[0] < begin)
            for tag, curve in history.curves.items()
        }
        for tag, events in scalars.items():
            points = {step: value for step, value in history.curves.get(tag, ())}
            points.update({event.step: event.value for event in events})
            history.curves[tag] = tuple(sorted(points.items()))
    history.curves = {tag: curve for tag, curve in history.curves.items() if curve}
    return history


def finite(curve: Curve) -> list[float]:
    """The values of a curve that are finite."""
    return [value for _, value in curve if math.isfinite(value)]


def tags(histories: Sequence[History], beginning: str) -> list[str]:
    """Names of the curves of any run that begin so, in alphabetical order."""
    return sorted({tag for it in histories for tag in it.curves if tag.startswith(beginning)})


def _scalars(path: Path) -> dict[str, list[Any]]:
    # 0 keeps all scalars; of the rest, which may be large, nothing is looked at.
    sizes = {"scalars": 0, "images": 1, "tensors": 1, "histograms": 1, "audio": 1}
    events = EventAccumulator(str(path), size_guidance=sizes)
    events.Reload()
    return {tag: events.Scalars(tag) for tag in events.Tags()["scalars"]}
