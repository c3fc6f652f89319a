"""What one training of the ablations came to, looked up by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fluidsnet.report.events import RATE, TRAINED, Curve
from fluidsnet.report.run import ROLLED, Run, read_runs
from fluidsnet.reporting.table import Cell
from fluidsnet.studies.ablations.trained_run import TrainedRun

#: The paper's network, and the twins that an `Ablation` trains beside it.
MODEL, ACCELERATION, WITHOUT = "model", "acceleration", "no_global_feature"
#: Names for a reader.
LABELS = {
    MODEL: "model (velocity, global feature)",
    ACCELERATION: "acceleration target",
    WITHOUT: "without global feature",
}
#: Tables of a run's rollouts: from the first frame, and from one in which the fluid is fast.
REST, MOTION = ROLLED, f"{ROLLED}_in_motion"
#: Names for a reader.
STARTS = {REST: "from rest", MOTION: "in motion"}
#: Tables of a run that the study is read from.
_READ = ("one_step", *STARTS, "global_feature_permutation")


@dataclass(frozen=True)
class Numbers:
    """A run's numbers; what is not there is None.

    Attributes:
        trained: which run it is.
        run: its files, read.
    """

    trained: TrainedRun
    run: Run

    def one_step(self, who: str, column: str) -> float | None:
        """A number of `one_step.csv`."""
        return self._find("one_step", {"one step ahead": who.replace("_", " ")}, column)

    def rollout(self, who: str, steps: int, column: str, start: str = REST) -> float | None:
        """A number of a table in `STARTS`."""
        row: dict[str, Cell] = {"predictor": who.replace("_", " "), "steps": steps}
        return self._find(start, row, column)

    def times(self, start: str = REST) -> dict[int, float]:
        """Time in s by number of steps, of the rows of a table in `STARTS` that have both."""
        return dict(time for time in self._times(start) if time is not None)

    @property
    def time_step(self) -> float | None:
        """Of the network, s."""
        return next((time / steps for steps, time in self.times().items()), None)

    @property
    def foreign_ratio(self) -> float | None:
        """`velocity_mse` with another frame's global feature over that with its own."""
        row: dict[str, Cell] = {"global feature of": "another frame"}
        return self._find("global_feature_permutation", row, "velocity_mse / own")

    @property
    def training_steps(self) -> int:
        """How many were trained, as far as the logged losses and validations tell."""
        tags = (TRAINED, f"ablation/velocity_mse/{MODEL}")
        curves = [self.run.history.curves.get(tag, ()) for tag in tags]
        return max((curve[-1][0] + 1 for curve in curves if curve), default=0)

    @property
    def rates(self) -> tuple[float, float] | None:
        """The model's learning rate at the start of training and at its end, if it was logged."""
        # With twins there is one of each model.
        for tag in (f"{RATE}/{MODEL}", RATE):
            curve = self.run.history.curves.get(tag)
            if curve:
                return curve[0][1], curve[-1][1]
        return None

    def curve(self, figure: str, who: str) -> Curve:
        """What validations logged of a model: (training step, value)."""
        return self.run.history.curves.get(f"ablation/{figure}/{who}", ())

    def step_seconds(self, who: str) -> float | None:
        """Time of a training step."""
        curve = self.curve("cost/step_seconds", who)
        return curve[-1][1] if curve else None

    def missing(self) -> list[str]:
        """Sentences, one for each file that is not there or cannot be read."""
        place = f"{self.trained.scene}, stride {self.trained.stride}, seed {self.trained.seed}"
        absent = [f"there is no {name}.csv." for name in _READ if name not in self.run.tables]
        absent += [
            f"{start}.csv has rows without steps or time; they are left out."
            for start in STARTS
            if None in self._times(start)
        ]
        if not self.curve("velocity_mse", MODEL):
            absent.append("no validation was logged.")
        return [f"{place}: {sentence}" for sentence in (*self.run.unread, *absent)]

    def _times(self, start: str) -> list[tuple[int, float] | None]:
        """Steps and time of each row; None for one that has no such numbers."""
        grid = self.run.tables.get(start)
        if grid is None:
            return []
        if not {"steps", "time s"} <= set(grid.columns):
            return [None]
        return [
            (steps, float(time))
            if isinstance(steps, int) and not isinstance(time, str) and steps > 0 and time > 0
            else None
            for steps, time in zip(grid["steps"], grid["time s"], strict=True)
        ]

    def _find(self, table: str, row: dict[str, Cell], column: str) -> float | None:
        grid = self.run.tables.get(table)
        if grid is None or not {*row, column} <= set(grid.columns):
            return None
        found = (it[column] for it in grid.to_dict("records") if row.items() <= it.items())
        cell = next(found, "")
        # An empty cell is what was not measured.
        return None if isinstance(cell, str) else float(cell)


#: Finds a number of a run, if it is there.
Lookup = Callable[[Numbers], float | None]


def one_step(who: str, column: str) -> Lookup:
    """Finds a number of `one_step.csv`."""
    return lambda run: run.one_step(who, column)


def rollout(who: str, steps: int, column: str, start: str = REST) -> Lookup:
    """Finds a number of a table in `STARTS`."""
    return lambda run: run.rollout(who, steps, column, start)


def read_numbers(runs: Sequence[TrainedRun]) -> list[Numbers]:
    """Reads what runs left.

    Raises:
        UserError: a folder is not one of a run, or is named twice.
    """
    read = read_runs([run.folder for run in runs]) if runs else []
    return [Numbers(trained, run) for trained, run in zip(runs, read, strict=True)]
