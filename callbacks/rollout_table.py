"""The rollouts' errors against the number of steps."""

from __future__ import annotations

import numpy as np
from lightning import Callback, LightningModule, Trainer
from torch import distributed

from fluidsnet.export.vtkhdf import read_field_data
from fluidsnet.metrics.rollout_errors import RolloutErrors
from fluidsnet.particles import RolloutStart
from fluidsnet.reporting.rollout_scalars import logged_steps
from fluidsnet.reporting.run_folder import rollout_file, run_folder
from fluidsnet.reporting.table import Cell, write_table
from fluidsnet.rollout import RolloutObserver


class RolloutTable(Callback, RolloutObserver):
    """After ``predict``, writes ``rollout.md`` and ``rollout.csv`` into the run's folder.

    A row a number of steps, over all simulations whose truth goes that far: the mean
    particle error of the model, of its integrator fed with the true velocities, and of the
    trivial predictors, all from the same start; and the share of particles that escaped.
    It reads the files of `TrajectoryWriter`, which must come before it, and prints the table.
    """

    _header = (
        "steps",
        "time s",
        "simulations",
        "model mm",
        "integrator floor mm",
        "constant velocity mm",
        "ballistic mm",
        "escaped %",
    )

    def __init__(self) -> None:
        self._names: list[str] = []

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Learns the run's folder."""
        self._folder = run_folder(trainer)

    def on_predict_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Forgets earlier rollouts."""
        self._names = []

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Notes that the simulation has a file."""
        self._names.append(start.name)

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes and prints the table."""
        names = _of_all_processes(self._names)
        if not trainer.is_global_zero:
            return
        columns = [read_field_data(rollout_file(self._folder, name)) for name in names]
        longest = max((_compared(column) for column in columns), default=0)
        rows: list[list[Cell]] = []
        for step in logged_steps(longest):
            there = [column for column in columns if 0 < step <= _compared(column)]
            if not there:
                continue
            means = [
                float(np.mean([column[name][step] for column in there]))
                for name in RolloutErrors.names
            ]
            time = float(there[0]["time"][step])
            rows.append([step, time, len(there), *means[:-1], 100 * means[-1]])
        path = self._folder / "rollout"
        print(f"\n{write_table(path, self._header, rows)}\n{path}.md")


def _of_all_processes(names: list[str]) -> list[str]:
    """The names that each process has, in order; their files are then written."""
    if not (distributed.is_available() and distributed.is_initialized()):
        return names
    gathered: list[list[str]] = [[] for _ in range(distributed.get_world_size())]
    distributed.all_gather_object(gathered, names)
    return sorted(name for names in gathered for name in names)


def _compared(column: dict[str, np.ndarray]) -> int:
    """The last step of a rollout that there is a truth for."""
    return int(np.flatnonzero(~np.isnan(column["position_error_mm"]))[-1])
