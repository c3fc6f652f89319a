"""A file of TensorBoard events, read as far as it is whole."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.tensorflow_stub.errors import DataLossError, OutOfRangeError
from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import PyRecordReader_New


class Scalar(NamedTuple):
    """A value, the step that it was logged at, and when that was, in s."""

    step: int
    value: float
    time: float


@dataclass
class EventFile:
    """What is in an event file.

    Attributes:
        scalars: by tag, in the order of the file.
        began: when its first event was written, s; infinite if there is none.
        flaw: a sentence that says where the file breaks off; empty where it is whole.
    """

    scalars: dict[str, list[Scalar]] = field(default_factory=dict)
    began: float = math.inf
    flaw: str = ""


def read_event_file(path: Path) -> EventFile:
    """Reads the scalars of an event file, those before its first damage if it has one.

    Args:
        path: of the file.

    Raises:
        OSError: it cannot be read.
    """
    found = EventFile()
    last: int | None = None
    flaw = ""
    try:
        for event in _events(path):
            found.began = min(found.began, event.wall_time)
            for value in event.summary.value:
                if value.HasField("simple_value"):
                    last = event.step
                    scalar = Scalar(event.step, value.simple_value, event.wall_time)
                    found.scalars.setdefault(value.tag, []).append(scalar)
    except EOFError:
        flaw = "ends within a record, as after its process was killed"
    except ValueError:
        flaw = "is damaged"
    if flaw:
        rest = f"what followed a value at step {last} is missing"
        found.flaw = f"{path.name} {flaw}: {'no value precedes that' if last is None else rest}."
    return found


def _events(path: Path) -> Iterator[Any]:
    """The events of a file.

    Raises:
        EOFError: the file ends within a record.
        ValueError: a checksum is wrong, or a record holds no event.
    """
    # What TensorBoard's readers rest upon; they themselves take damage for the end.
    reader = PyRecordReader_New(str(path))
    while True:
        try:
            reader.GetNext()
        except OutOfRangeError:
            return
        except DataLossError as error:
            raise (EOFError if "truncated" in str(error) else ValueError) from error
        try:
            event = Event.FromString(reader.record())
        except Exception as error:  # protobuf's own, of what is no event
            raise ValueError from error
        yield event
