"""Training curves from a run's TensorBoard event files."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from tensorboard.backend.event_processing.event_accumulator import ScalarEvent
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.tensorflow_stub.errors import DataLossError, OutOfRangeError
from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import PyRecordReader_New

PATTERN = "events.out.tfevents.*"
TRAINED = "train/loss"
#: Learning rate; with ablation twins one tag for each model.
RATE = "train/learning_rate"
#: Tags logged at training steps. Others, such as Lightning's `hp_metric`, may be at step 0.
_OF_TRAINING = ("train/", "val/", "ablation/")

#: Points (step, value), in order of steps.
Curve = tuple[tuple[int, float], ...]
#: Logged values by tag, in the order of a file.
Scalars = dict[str, list[ScalarEvent]]


@dataclass
class History:
    """Scalars of a training by tag."""

    curves: dict[str, Curve] = field(default_factory=dict)
    seconds: float = 0.0  # duration of the training, over all its files
    unread: list[str] = field(default_factory=list)  # a sentence for each damaged file


def read_event_file(path: Path) -> tuple[Scalars, str]:
    """Return the scalars of an event file up to its end or first damage, and a sentence on it.

    Raises:
        OSError: The file cannot be read.
    """
    scalars: Scalars = {}
    missing = "no value precedes that"
    # EventAccumulator uses the same reader, but stops silently at damage.
    reader = PyRecordReader_New(str(path))
    try:
        while True:
            reader.GetNext()
            event = Event.FromString(reader.record())
            for value in event.summary.value:
                if value.HasField("simple_value"):
                    scalar = ScalarEvent(event.wall_time, event.step, value.simple_value)
                    scalars.setdefault(value.tag, []).append(scalar)
                    missing = f"what followed a value at step {event.step} is missing"
    except OutOfRangeError:
        return scalars, ""
    except (DataLossError, DecodeError) as error:
        cut = "has truncated record" in str(error)
    flaw = "ends within a record, as after its process was killed" if cut else "is damaged"
    return scalars, f"{path.name} {flaw}: {missing}."


def read_history(folder: Path) -> History:
    """Read the training curves from the event files of a run.

    Each command on a run writes one file. The values of a resumed or repeated training replace
    earlier ones from its first step on. Files without a training loss and without a step above
    0 are no trainings and are left out.
    """
    history = History()
    parts: list[tuple[float, float, Scalars]] = []
    for path in sorted(folder.glob(PATTERN)):
        try:
            scalars, flaw = read_event_file(path)
        except OSError as error:
            scalars, flaw = {}, f"{path.name} cannot be read: {error.strerror}."
        history.unread += [flaw] if flaw else []
        times = [scalar.wall_time for values in scalars.values() for scalar in values]
        parts += [(min(times), max(times), scalars)] if times else []
    curves: dict[str, dict[int, float]] = {}
    for begin, end, scalars in sorted(parts, key=lambda part: part[0]):
        steps = {it.step for tag in scalars if tag.startswith(_OF_TRAINING) for it in scalars[tag]}
        if TRAINED not in scalars and not any(steps):
            continue
        history.seconds += end - begin
        for tag, points in curves.items():
            curves[tag] = {step: value for step, value in points.items() if step < min(steps)}
        for tag, values in scalars.items():
            curves.setdefault(tag, {}).update((it.step, it.value) for it in values)
    history.curves = {tag: tuple(sorted(it.items())) for tag, it in curves.items() if it}
    return history


def finite(curve: Curve) -> Curve:
    """Return the points of a curve with finite values."""
    return tuple(point for point in curve if math.isfinite(point[1]))
