"""Independent tasks of the trade study, run one after another or on a cluster."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.studies.machine import OtherLoad
from fluidsnet.studies.trade.measure import Measured, measure
from fluidsnet.studies.trade.options import TradeOptions
from fluidsnet.studies.trade.points import Point

#: Results of a task, or why it failed.
Outcome = Measured | str
#: Longest time until a scheduler answers.
CONNECT = "20s"


@final
@dataclass(frozen=True)
class Task:
    """A point to measure in one simulation.

    Attributes:
        point: Point.
        data: Data file.
        simulation: Name of the simulation.
        options: What to measure.
    """

    point: Point
    data: str
    simulation: str
    options: TradeOptions

    def run(self, advance: Callable[[], None] = lambda: None) -> Outcome:
        """Measure the point; a failure is returned in words.

        Args:
            advance: Called now and then meanwhile.
        """
        try:
            reader = FrameReader(Path(self.data))
            with OtherLoad() as load:
                measured = measure(self.point, reader, self.simulation, self.options, advance)
            reader.close()
        except Exception as error:
            # Whatever it is, the other points of a study of hours go on.
            return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        return replace(measured, others=load.cores)


class Engine(ABC):
    """Way to run tasks."""

    @abstractmethod
    def run(
        self, tasks: Sequence[Task], advance: Callable[[Task], None]
    ) -> Iterator[tuple[Task, Outcome]]:
        """Yield each task with its outcome as it ends.

        Args:
            tasks: Tasks.
            advance: Called now and then with a task that runs.
        """


@final
class InTurn(Engine):
    """Run the tasks in this process, one after another, so that none disturbs another's times."""

    def run(
        self, tasks: Sequence[Task], advance: Callable[[Task], None]
    ) -> Iterator[tuple[Task, Outcome]]:
        for task in tasks:
            advance(task)
            yield task, task.run(lambda task=task: advance(task))  # type: ignore[misc]


@final
class Cluster(Engine):
    """Run the tasks on the workers of a Dask cluster, one at a time on each.

    Args:
        scheduler: Address of a running scheduler; if empty, a cluster on this machine.
        workers: Processes of a cluster on this machine.

    Raises:
        UserError: Dask's `distributed` is not installed, or the scheduler cannot be reached.
    """

    def __init__(self, scheduler: str, workers: int) -> None:
        try:
            import distributed
        except ImportError as error:
            raise UserError(
                "--workers and --scheduler need Dask: install it with "
                "`pip install 'fluidsnet[cluster]'`."
            ) from error
        self._distributed: Any = distributed
        self._scheduler, self._workers = scheduler, workers

    def run(
        self, tasks: Sequence[Task], advance: Callable[[Task], None]
    ) -> Iterator[tuple[Task, Outcome]]:
        if not tasks:
            return
        with self._client() as client:
            futures = {client.submit(Task.run, task, pure=False): task for task in tasks}
            for future in self._distributed.as_completed(list(futures)):
                task = futures[future]
                advance(task)
                error = future.exception()
                yield task, f"{type(error).__name__}: {error}" if error else future.result()

    def _client(self) -> Any:
        """Return a client of the scheduler, or of a new cluster that ends with it."""
        if not self._scheduler:
            return self._distributed.Client(
                n_workers=self._workers, threads_per_worker=1, dashboard_address=None
            )
        try:
            return self._distributed.Client(self._scheduler, timeout=CONNECT)
        except (OSError, ValueError) as error:
            raise UserError(f"--scheduler {self._scheduler}: {error}.") from error
