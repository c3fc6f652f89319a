"""One measurement of a network in a process of its own, so that its peak memory is its own.

Started as ``python -m fluidsnet.studies.trial trial.json result.json``.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import torch

from fluidsnet.errors import UserError
from fluidsnet.memory import free_bytes

Precision = Literal["float32", "bfloat16", "float16"]

#: The ranges a step is made of, as `Network.forward` names them.
STAGES = ("sort", "search", "search + local", "local", "voxel", "global", "head")


@dataclass(frozen=True)
class Trial:
    """What one process measures.

    Attributes:
        kind: of measurement: a step; the velocities it should predict; many frames at once; or
            what the cores can do.
        states: a data file; the network starts from its last frame, or its last `batch` frames.
        model: a file with a `model:`; the paper's network where none is named.
        run: the folder of a training run, in place of it.
        neighbors: the search, a class of `fluidsnet.neighbors`.
        precision: of autocast, or float32.
        compile: whether torch.compile has its turn.
        device: of the network.
        threads: of torch and numba.
        repeats: how often a step is timed.
        seconds: about as long it may take; there are fewer repeats then.
        batch: frames predicted at once.
        reference: file of the velocities the kind `reference` leaves and `step` compares with.
    """

    kind: Literal["step", "reference", "batch", "cores"]
    states: str = ""
    model: str | None = None
    run: str | None = None
    neighbors: str = "Auto"
    precision: Precision = "float32"
    compile: bool = False
    device: str = "cpu"
    threads: int = 1
    repeats: int = 7
    seconds: float = 60.0
    batch: int = 8
    reference: str = ""


@dataclass(frozen=True)
class Result:
    """What a process measured.

    Attributes:
        step: s of each repeat: a step, or all frames of a batch.
        search: s of each repeat of the search alone, its edges stored.
        stages: s of each of `STAGES` that a step has, medians.
        peak: bytes a step takes at its peak beyond the loaded model and state.
        error: mean |Δv| against the reference over its root mean square.
        edges: neighbors of a particle, on average.
        batches: frames in each batch.
        solids: wall particles.
        cores: what `measure_cores` says.
        failure: why there is nothing else.
    """

    step: list[float] = field(default_factory=list)
    search: list[float] = field(default_factory=list)
    stages: dict[str, float] = field(default_factory=dict)
    peak: int | None = None
    error: float | None = None
    edges: float | None = None
    batches: list[int] = field(default_factory=list)
    solids: int = 0
    cores: dict[str, float] = field(default_factory=dict)
    failure: str = ""


def _limit_memory(trial: Trial) -> None:
    """Has what does not fit fail here, and not the machine."""
    if sys.platform != "linux" or trial.device != "cpu":
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = int(0.9 * free_bytes(torch.device("cpu")))
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))


def main(arguments: list[str]) -> int:
    """Measures what the file named first says and leaves the result in the one named second."""
    # Imports this module for what it reads and writes.
    from fluidsnet.studies.bench import measure

    trial = Trial(**json.loads(Path(arguments[0]).read_text()))
    _limit_memory(trial)
    try:
        result = measure(trial)
    except UserError as error:
        result = Result(failure=f"{error}")
    except (MemoryError, RuntimeError) as error:
        words = str(error)
        if not isinstance(error, MemoryError | torch.OutOfMemoryError) and (
            "allocate" not in words
        ):
            raise
        result = Result(failure="out of memory")
    Path(arguments[1]).write_text(json.dumps(asdict(result)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
