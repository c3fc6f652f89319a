"""Simulations of another format, as the writer of data files takes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from datamodules.schema import Header, SceneAttributes

#: Real numbers.
Array = NDArray[Any]

#: Positions of no particles.
NO_SOLIDS: Array = np.empty((0, 3), np.float32)


class Frame(NamedTuple):
    """State of a simulation at one time.

    Attributes:
        position: (N, 3) m; row i is the same particle in every frame.
        velocity: (N, 3) m/s.
        solid_position: (M, 3) m, only where solids move.
        solid_velocity: (M, 3) m/s, only where solids move.
    """

    position: Array
    velocity: Array
    solid_position: Array | None = None
    solid_velocity: Array | None = None


@dataclass(frozen=True)
class Simulation:
    """Simulation whose frames are read one after the other.

    Attributes:
        scene: Attributes of its scene.
        frames: Returns an iterator over the frames, in order of time.
        solid_position: (M, 3) m of solids at rest; not used where frames have solids.
        datasets: Further data sets of its group; `time` and `solver_seconds` replace the default.
        attributes: Further attributes of its group.
    """

    scene: SceneAttributes
    frames: Callable[[], Iterator[Frame]]
    solid_position: Array = field(default_factory=lambda: NO_SOLIDS)
    datasets: Mapping[str, Array] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)


class Source(Protocol):
    """Data of another format.

    Attributes:
        header: Attributes of the files to be written.
        splits: Names of the simulations of each split that there is.
        frames: Number of frames of all simulations; None if it is not known before they are read.
        notes: Sentences for the user on what was assumed or left out.
    """

    header: Header
    splits: dict[str, list[str]]
    frames: int | None
    notes: list[str]

    def open(self, split: str, name: str) -> Simulation:
        """Return a simulation.

        Raises:
            UserError: It cannot be read or represented.
        """
        ...
