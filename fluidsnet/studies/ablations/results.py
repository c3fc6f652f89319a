"""Results of the study's trainings, read from their folders and grouped by scene and stride."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import yaml

from fluidsnet.errors import UserError
from fluidsnet.report.events import RATE, TRAINED, Curve, read_history
from fluidsnet.report.tables import read_table
from fluidsnet.reporting.results import results_folders

#: The paper's network and its twins, and their labels in the report.
MODEL, ACCELERATION, WITHOUT = "model", "acceleration", "no global feature"
LABELS = {
    MODEL: "model (velocity, global feature)",
    ACCELERATION: "acceleration target",
    WITHOUT: "without global feature",
}
ONE_STEP, PERMUTATION = "one_step", "global_feature_permutation"
#: Tables of rollouts from the first frame, and from a frame in which the fluid is fast.
REST, MOTION = "rollout_metrics", "rollout_metrics_in_motion"
STARTS = {REST: "from rest", MOTION: "in motion"}
ENERGY = "kinetic_energy J/kg"
#: Time at which rollouts are reported beside their end, s.
_MIDDLE = 0.25


class TrainedRun(NamedTuple):
    """One training with its twins, finished or not: its scene, stride, seed and folder."""

    scene: str
    stride: int
    seed: int
    folder: Path


class Moment(NamedTuple):
    """Number of steps of a rollout and their time in s."""

    steps: int
    time: float


@dataclass(frozen=True)
class Results:
    """Results of one run.

    Attributes:
        tables: Results tables by name, with the columns scene, stride, seed, predictor and steps.
        curves: Logged scalars by tag.
        problems: Sentences on files that are missing or damaged.
    """

    tables: Mapping[str, pd.DataFrame]
    curves: Mapping[str, Curve]
    problems: list[str]

    def curve(self, metric: str, predictor: str) -> pd.Series[float]:
        """Return a metric of the validations by training step; the first step is 0."""
        tag = f"ablation/{metric}/{predictor.replace(' ', '_')}"
        return pd.Series(dict(self.curves.get(tag, ())), dtype=float)

    @property
    def training_steps(self) -> int:
        """Number of training steps, according to the logged losses and validations."""
        curves = [self.curves.get(tag, ()) for tag in (TRAINED, f"ablation/velocity_mse/{MODEL}")]
        return max((curve[-1][0] + 1 for curve in curves if curve), default=0)

    @property
    def learning_rates(self) -> tuple[float, float] | None:
        """Learning rate of the model at the start and at the end of training, where logged."""
        # The tag ends with the model's name where several models are trained.
        curve = self.curves.get(f"{RATE}/{MODEL}") or self.curves.get(RATE)
        return (curve[0][1], curve[-1][1]) if curve else None


@dataclass(frozen=True)
class Group:
    """Runs on one scene with one stride, one per seed."""

    scene: str
    stride: int
    runs: Sequence[Results]

    @property
    def seeds(self) -> str:
        """Number of seeds, in words."""
        return f"{len(self.runs)} seed{'s' * (len(self.runs) != 1)}"

    @property
    def step(self) -> str:
        """Time step in words, or the stride where no rollout gives the time step."""
        for moment in self.moments(REST):
            return f"{1000 * moment.time / moment.steps:.4g} ms a step"
        return f"stride {self.stride}"

    @property
    def title(self) -> str:
        """Heading of the group."""
        stride = f" (stride {self.stride})" if self.moments(REST) else ""
        return f"{self.scene}, {self.step}{stride}, {self.seeds}"

    @cached_property
    def tables(self) -> dict[str, pd.DataFrame]:
        """`Results.tables` of all runs, concatenated."""
        return {
            name: pd.concat([results.tables[name] for results in self.runs], ignore_index=True)
            for name in (ONE_STEP, *STARTS, PERMUTATION)
        }

    def values(
        self, predictor: str, metric: str, table: str = ONE_STEP, steps: int = 1
    ) -> dict[int, float]:
        """Return a number by seed, for the seeds that have it."""
        rows = self.tables[table]
        rows = rows[(rows["predictor"] == predictor) & (rows["steps"] == steps)]
        values = zip(rows["seed"], rows.get(metric, ()), strict=False)
        # An empty cell was not measured.
        return {seed: float(value) for seed, value in values if not isinstance(value, str)}

    def moments(self, start: str) -> list[Moment]:
        """Return the moment nearest to 0.25 s and the last one, of a table of rollouts."""
        rows = self.tables[start]
        times = dict(zip(rows["steps"], rows["time s"], strict=True))
        moments = [Moment(int(steps), float(time)) for steps, time in sorted(times.items())]
        before = sorted(moments[:-1], key=lambda moment: abs(moment.time - _MIDDLE))
        return [*before[:1], *moments[-1:]]


def read_groups(runs: Sequence[TrainedRun]) -> list[Group]:
    """Read the results of runs; group them by scene and stride, in order of seeds.

    Raises:
        UserError: A folder is not the folder of a run.
    """
    groups = groupby(sorted(runs), key=lambda run: (run.scene, run.stride))
    return [Group(scene, stride, [*map(_read, members)]) for (scene, stride), members in groups]


def _read(run: TrainedRun) -> Results:
    if not run.folder.is_dir():
        raise UserError(f"{run.folder} is not the folder of a run: there is no such folder.")
    history = read_history(run.folder)
    problems, tables = [*history.unread], {}
    folder = _results_folder(run.folder)
    for name in (ONE_STEP, *STARTS, PERMUTATION):
        table = pd.DataFrame(columns=["predictor", "steps", "time s"])
        try:
            table = read_table(folder / f"{name}.csv")
        except FileNotFoundError:
            problems.append(f"there is no {name}.csv.")
        except (OSError, ValueError) as error:
            problems.append(f"{name}.csv cannot be read: {error}.")
        table = table.rename(columns={table.columns[0]: "predictor"})
        if name in STARTS:
            times = table.reindex(columns=["steps", "time s"]).apply(pd.to_numeric, errors="coerce")
            valid = (times > 0).all(axis="columns") & (times["steps"] % 1 == 0)
            table = table.assign(**times)[valid]
            if not valid.all():
                problems.append(f"{name}.csv has rows without steps or time; they are left out.")
        else:
            table = table.assign(steps=1)
        tables[name] = table.assign(scene=run.scene, stride=run.stride, seed=run.seed)
    if f"ablation/velocity_mse/{MODEL}" not in history.curves:
        problems.append("no validation was logged.")
    place = f"{run.scene}, stride {run.stride}, seed {run.seed}"
    return Results(tables, history.curves, [f"{place}: {problem}" for problem in problems])


def _results_folder(run: Path) -> Path:
    """Return the folder of the results on the data that the run was trained on."""
    folders = [*results_folders(run)]
    if len(folders) < 2:
        return folders[0] if folders else run
    config = yaml.safe_load((run / "config.yaml").read_text())
    name = Path(config["data"]["init_args"]["root"]).name
    return next((folder for folder in folders if folder.name == name), folders[0])
