"""Training curves from a run's TensorBoard event files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from tensorboard.backend.event_processing.event_accumulator import ScalarEvent
from tensorboard.backend.event_processing.event_file_loader import RawEventFileLoader
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import masked_crc32c

PATTERN = "events.out.tfevents.*"
TRAINED = "train/loss"
#: Learning rate; with ablation twins one tag for each model.
RATE = "train/learning_rate"

#: Tags logged at training steps. Others, such as Lightning's `hp_metric`, may be at step 0.
_OF_TRAINING = ("train/", "val/", "ablation/")
#: Bytes of a record beside its data: length (8), checksum of the length (4), of the data (4).
_FRAMING = 16

#: Points (step, value), in order of steps.
Curve = tuple[tuple[int, float], ...]
#: Logged values by tag, in the order of a file.
Scalars = dict[str, list[ScalarEvent]]


@dataclass
class History:
    """Scalars of a training.

    Attributes:
        curves: Points by tag.
        seconds: Duration of all training sessions, s.
        unread: A sentence for each file that is damaged or cannot be read.
    """

    curves: dict[str, Curve] = field(default_factory=dict)
    seconds: float = 0.0
    unread: list[str] = field(default_factory=list)


def read_event_file(path: Path) -> tuple[Scalars, str]:
    """Read the scalars of an event file up to its end or its first damage.

    Returns:
        The scalars, and a sentence on where the file breaks off; empty if it is whole.

    Raises:
        OSError: The file cannot be read.
    """
    scalars: Scalars = {}
    last, offset = None, 0
    try:
        for record in RawEventFileLoader(str(path)).Load():
            event = Event.FromString(record)
            offset += len(record) + _FRAMING
            for value in event.summary.value:
                if value.HasField("simple_value"):
                    last = event.step
                    scalar = ScalarEvent(event.wall_time, event.step, value.simple_value)
                    scalars.setdefault(value.tag, []).append(scalar)
    except DecodeError:
        pass
    # TensorBoard's loader stops silently at damage: compare what it read with the file.
    rest = path.read_bytes()[offset:]
    if not rest:
        return scalars, ""
    flaw = "ends within a record, as after its process was killed" if _cut(rest) else "is damaged"
    missing = f"what followed a value at step {last} is missing"
    return scalars, f"{path.name} {flaw}: {'no value precedes that' if last is None else missing}."


def read_history(folder: Path) -> History:
    """Read the training curves from the event files of a run.

    Each session of a run writes one file. The values of a resumed or repeated training replace
    earlier ones from its first step on. Sessions without a training loss and without a step above
    0 are no trainings and are left out.

    Args:
        folder: Folder of the run.
    """
    history = History()
    sessions: list[Scalars] = []
    for path in sorted(folder.glob(PATTERN)):
        try:
            scalars, flaw = read_event_file(path)
        except OSError as error:
            flaw = f"{path.name} cannot be read: {error.strerror}."
        else:
            sessions.append(scalars)
        history.unread += [flaw] if flaw else []
    curves: dict[str, dict[int, float]] = {}
    for scalars in sorted(filter(None, sessions), key=lambda it: min(_times(it))):
        steps = {it.step for tag in scalars if tag.startswith(_OF_TRAINING) for it in scalars[tag]}
        if TRAINED not in scalars and not any(steps):
            continue
        history.seconds += max(_times(scalars)) - min(_times(scalars))
        curves = {
            tag: {step: value for step, value in points.items() if step < min(steps)}
            for tag, points in curves.items()
        }
        for tag, values in scalars.items():
            curves.setdefault(tag, {}).update((it.step, it.value) for it in values)
    history.curves = {
        tag: tuple(sorted(points.items())) for tag, points in curves.items() if points
    }
    return history


def finite(curve: Curve) -> list[float]:
    """Return the finite values of a curve."""
    return [value for _, value in curve if math.isfinite(value)]


def tags(histories: Sequence[History], prefix: str) -> list[str]:
    """Return the sorted tags of all histories that start with a prefix."""
    return sorted({tag for it in histories for tag in it.curves if tag.startswith(prefix)})


def _times(scalars: Scalars) -> list[float]:
    return [it.wall_time for values in scalars.values() for it in values]


def _cut(rest: bytes) -> bool:
    """Return whether a file ends before its next record does; `rest` starts at that record."""
    if len(rest) < 12:
        return True
    length, checksum = int.from_bytes(rest[:8], "little"), int.from_bytes(rest[8:12], "little")
    return masked_crc32c(rest[:8]) == checksum and len(rest) < length + _FRAMING
