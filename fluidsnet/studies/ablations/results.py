"""Results of the study's runs: one long table of numbers for each scene and stride."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import yaml

from fluidsnet.errors import UserError
from fluidsnet.report.events import RATE, TRAINED, read_history
from fluidsnet.report.tables import read_table
from fluidsnet.reporting.results import DATA_FILE, results_folders

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
#: Name of the logged values in the column `table`.
_CURVES = "curves"
COST, MSE, ENERGY = "cost/step_seconds", "velocity_mse m²/s²", "kinetic_energy J/kg"
#: Metric and predictor of the logged values, by tag.
_TAGS = {
    f"ablation/{metric}/{name.replace(' ', '_')}": (metric, name)
    for metric in ("velocity_mse", "skill", COST)
    for name in LABELS
}
# The learning rate's tag ends with the model's name where several models are trained.
_TAGS |= {TRAINED: (TRAINED, MODEL), RATE: (RATE, MODEL), f"{RATE}/{MODEL}": (RATE, MODEL)}
#: Columns that name a run, and columns of its numbers.
RUN = ["scene", "stride", "seed"]
_COLUMNS = ("table", "predictor", "steps", "time", "metric", "value")
#: Time at which rollouts are reported beside their end, s.
_MIDDLE = 0.25


class TrainedRun(NamedTuple):
    """One training with its twins, finished or not: its scene, stride, seed and folder."""

    scene: str
    stride: int
    seed: int
    folder: Path


@dataclass(frozen=True)
class Group:
    """Runs on one scene with one stride, one per seed.

    Attributes:
        rows: One number a row: its scene, stride, seed, table, predictor, steps, time (s), metric
            and value. Logged values have the table "curves"; their steps are training steps.
        problems: Sentences on files that are missing or damaged.
    """

    scene: str
    stride: int
    seeds: Sequence[int]
    rows: pd.DataFrame
    problems: Sequence[str]

    @property
    def seeds_text(self) -> str:
        """Number of seeds, in words."""
        return f"{len(self.seeds)} seed{'s' * (len(self.seeds) != 1)}"

    @property
    def step(self) -> str:
        """Time step in words, or the stride where no rollout gives the time step."""
        for steps, time in self.moments(REST):
            return f"{1000 * time / steps:.4g} ms a step"
        return f"stride {self.stride}"

    @property
    def title(self) -> str:
        """Heading of the group."""
        stride = f" (stride {self.stride})" if self.moments(REST) else ""
        return f"{self.scene}, {self.step}{stride}, {self.seeds_text}"

    @property
    def training_steps(self) -> list[int]:
        """Number of training steps of each seed, according to the logged values."""
        logged = self.rows[self.rows["table"] == _CURVES].groupby("seed")["steps"].max() + 1
        return [int(logged.get(seed, 0)) for seed in self.seeds]

    def select(self, table: str, metric: str, predictor: str) -> pd.DataFrame:
        """Return the rows of one metric of one predictor in a table."""
        return self.rows.query("table == @table and metric == @metric and predictor == @predictor")

    def values(
        self, predictor: str, metric: str, table: str = ONE_STEP, steps: int = 1
    ) -> pd.Series[float]:
        """Return a number by seed, for the seeds that have it."""
        rows = self.select(table, metric, predictor)
        return rows[rows["steps"] == steps].set_index("seed")["value"]

    def curves(self, metric: str, predictor: str = MODEL) -> list[pd.Series[float]]:
        """Return the logged values of each seed by training step; the first step is 0."""
        rows = self.select(_CURVES, metric, predictor).set_index("steps")
        return [rows.loc[rows["seed"] == seed, "value"] for seed in self.seeds]

    def moments(self, table: str) -> list[tuple[int, float]]:
        """Return steps and time (s) of a table's moments: nearest to 0.25 s, and the end."""
        rows = self.rows[self.rows["table"] == table]
        moments = sorted(dict(zip(rows["steps"], rows["time"], strict=True)).items())
        before = sorted(moments[:-1], key=lambda moment: abs(moment[1] - _MIDDLE))
        return [*before[:1], *moments[-1:]]

    def at_moments(self, table: str) -> pd.DataFrame:
        """Return the rows of a table at its moments."""
        rows = self.rows[self.rows["table"] == table]
        return rows[rows["steps"].isin([*dict(self.moments(table))])]


def read_groups(runs: Sequence[TrainedRun]) -> list[Group]:
    """Read the results of runs; group them by scene and stride, in order of seeds."""
    groups = []
    for (scene, stride), members in groupby(sorted(runs), key=lambda run: (run.scene, run.stride)):
        problems: list[str] = []
        tables = {run.seed: _read(run, problems) for run in members}
        rows = pd.concat(tables, names=["seed"]).reset_index("seed")
        rows = rows.assign(scene=scene, stride=stride)
        groups.append(Group(scene, stride, [*tables], rows, problems))
    return groups


def _read(run: TrainedRun, problems: list[str]) -> pd.DataFrame:
    """Return the numbers of a run, one a row; append sentences on what cannot be read."""
    if not run.folder.is_dir():
        raise UserError(f"{run.folder} is not the folder of a run: there is no such folder.")
    history = read_history(run.folder)
    found = [*history.unread]
    numbers: list[tuple[Any, ...]] = [
        (_CURVES, predictor, step, math.nan, metric, value)
        for tag, (metric, predictor) in _TAGS.items()
        for step, value in history.curves.get(tag, ())
    ]
    folder = _results_folder(run.folder)
    for name in (ONE_STEP, *STARTS, PERMUTATION):
        try:
            table = read_table(folder / f"{name}.csv")
        except FileNotFoundError:
            found.append(f"there is no {name}.csv.")
            continue
        except (OSError, ValueError) as error:
            found.append(f"{name}.csv cannot be read: {error}.")
            continue
        keys = table.reindex(columns=["steps", "time s"]).apply(pd.to_numeric, errors="coerce")
        if name in STARTS:
            valid = (keys > 0).all(axis="columns") & (keys["steps"] % 1 == 0)
            if not valid.all():
                found.append(f"{name}.csv has rows without steps or time; they are left out.")
            table, keys = table[valid], keys[valid]
        else:
            keys["steps"] = 1
        predictors = table.iloc[:, 0]
        metrics = table.iloc[:, 1:].drop(columns=[*keys], errors="ignore")
        numbers += [
            (name, predictor, *key, metric, value)
            for metric, values in metrics.items()
            for predictor, key, value in zip(predictors, keys.to_numpy(), values, strict=True)
            # An empty cell was not measured.
            if not isinstance(value, str)
        ]
    if f"ablation/velocity_mse/{MODEL}" not in history.curves:
        found.append("no validation was logged.")
    problems += [
        f"{run.scene}, stride {run.stride}, seed {run.seed}: {problem}" for problem in found
    ]
    rows = pd.DataFrame(numbers, columns=_COLUMNS).astype({"steps": int, "value": float})
    return rows.drop_duplicates([*_COLUMNS[:-1]], keep="last")


def _results_folder(run: Path) -> Path:
    """Return the folder of the results on the data that the run was trained on."""
    folders = [*results_folders(run)]
    if len(folders) < 2:
        return folders[0] if folders else run
    config = yaml.safe_load((run / "config.yaml").read_text())
    name = Path(config["data"]["init_args"]["root"]).name
    # Every test writes the note anew: the latest is of the data as they are.
    pattern = re.compile(rf"{re.escape(name)}(_\d+)?")
    found = [folder / DATA_FILE for folder in folders if pattern.fullmatch(folder.name)]
    notes = [note for note in found if note.exists()]
    return max(notes, key=lambda note: note.stat().st_mtime).parent if notes else folders[0]
