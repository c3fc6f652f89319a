"""Trade study: all points in all simulations, and its files."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

from jinja2 import Environment, PackageLoader

from datamodules.generate.solver import load_solver
from datamodules.reader import FrameReader
from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.errors import UserError
from fluidsnet.progress import Progress
from fluidsnet.studies.machine import BUSY, cpu_model, versions
from fluidsnet.studies.trade.engine import Cluster, Engine, InTurn, Task
from fluidsnet.studies.trade.figure import draw, hoverable
from fluidsnet.studies.trade.measure import Measured
from fluidsnet.studies.trade.model_points import ModelSteps
from fluidsnet.studies.trade.options import ModelPoint, TradeOptions
from fluidsnet.studies.trade.points import Point, Trivial
from fluidsnet.studies.trade.recommend import measured_from
from fluidsnet.studies.trade.report import EXPLANATION, write_report
from fluidsnet.studies.trade.rows import Row
from fluidsnet.studies.trade.solver_points import Solver, check_drawn, floors
from fluidsnet.studies.training import Training
from fluidsnet.whole_file import whole_file, write_whole

T = TypeVar("T")

#: Options that change what is measured of a point.
_MEASURE = ("every", "horizon", "steps", "marks")


class Study:
    """All points in all simulations; the tables are written when the points of one are done.

    Args:
        options: What to measure.

    Raises:
        UserError: The data cannot be read, a model cannot be loaded, or the solver is needed and
            not installed.
    """

    def __init__(self, options: TradeOptions) -> None:
        options = options.reduced()
        self.options, self.folder = options, Path(options.output)
        self._reader = FrameReader(Path(options.data))
        self._simulations = list(self._reader.frames)[: options.simulations]
        self.points: list[Point] = [*map(Trivial, TRIVIAL_PREDICTORS)]
        if options.solvers:
            load_solver()
            for simulation in self._simulations:
                check_drawn(self._reader.path, simulation)
            if options.floor:
                self.points += floors(self._reader.path, options.threads)
        self.points += [
            Solver(point, self._reader.path, options.threads) for point in options.solvers
        ]
        self._training = {it.label: math.nan for it in options.trainings}
        named = [point.label for point in self.points]
        named += [it.name for it in options.models] + [it.label for it in options.trainings]
        if len(set(named)) < len(named):
            raise UserError("Two points have the same label; give one another `label`.")
        self._add_models(options.models)
        self.results: dict[str, dict[str, Measured]] = {}
        self.failed: dict[str, dict[str, str]] = {}

    def run(self) -> None:
        """Train the networks and measure the points that are not finished yet."""
        self._train()
        options, results = self.options, self.results
        for point in self.points:
            results[point.label], self.failed[point.label] = {}, {}
        tasks = []
        # Points in turn within a simulation, so that a slow minute does not fall on one of them.
        for simulation in self._simulations:
            for point in self.points:
                task = Task(point, options.data, simulation, options)
                stored = self._stored(task)
                if stored is None:
                    tasks.append(task)
                else:
                    results[point.label][simulation] = stored
        with Progress(total=len(tasks), unit="point") as bar:

            def advance(task: Task) -> None:
                bar.set_description(task.point.label, refresh=False)
                bar.refresh()

            for task, outcome in self._engine().run(tasks, advance):
                label, simulation = task.point.label, task.simulation
                if isinstance(outcome, str):
                    self.failed[label][simulation] = outcome
                    bar.write(f"WARNING: {label} failed in {simulation}: {outcome}", sys.stderr)
                else:
                    results[label][simulation] = outcome
                    self._store(task, outcome)
                    if outcome.others > BUSY and task.point.kind != "trivial":
                        bar.write(
                            f"WARNING: others took {outcome.others:.1f} cores during {label}.",
                            sys.stderr,
                        )
                bar.update()
                if task.point is self.points[-1]:
                    self.write()
        self.write()

    def rows(self) -> list[Row]:
        """Return the points with what was measured so far."""
        return [
            Row(
                label=point.label,
                kind=point.kind,
                advice=point.advice,
                interval=self._reader.header.dt,
                measured=self._in_order(self.results[point.label]),
                failed=self._in_order(self.failed[point.label]),
                training=self._training.get(
                    point.label, math.nan if point.kind == "network" else 0.0
                ),
            )
            for point in self.points
        ]

    def _in_order(self, values: Mapping[str, T]) -> dict[str, T]:
        """Return values by simulation in the order of the file; tasks end in any order."""
        return {name: values[name] for name in self._simulations if name in values}

    def write(self) -> None:
        """Write tables, figure and page."""
        options, header, rows = self.options, self._reader.header, self.rows()
        fluid = [it.fluid for row in rows for it in row.measured.values()]
        step = 1000 * header.solver_parameters.get("timeStepSize", 0)
        notes = [
            f"{datetime.now():%Y-%m-%d}, {cpu_model()}, {options.threads} threads; {versions()}",
            f"{options.data}, {len(self._simulations)} simulations, "
            f"{sum(fluid) / max(len(fluid), 1):,.0f} fluid particles on average, a frame each "
            f"{1000 * header.dt:g} ms; truth: {header.solver} with steps of {step:g} ms",
        ]
        table, told = write_report(self.folder, notes, options, rows)
        figure = draw(options, rows)
        if figure is None:
            return
        with whole_file(self.folder / "trade.png") as partial:
            figure.savefig(partial, dpi=120)
        heading, _, *lines = (
            [cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.splitlines()
        )
        environment = Environment(loader=PackageLoader(__package__, "."), autoescape=True)
        page = environment.get_template("page.html").render(
            notes=notes,
            sentences=told,
            figure=hoverable(figure, rows),
            header=heading,
            cells=lines,
            failures=[
                f"{row.label} in {simulation}: {reason}"
                for row in rows
                for simulation, reason in row.failed.items()
            ],
            explanation=EXPLANATION,
        )
        write_whole(self.folder / "trade.html", page)

    def _add_models(self, models: Sequence[ModelPoint]) -> None:
        for model in models:
            point = ModelSteps(model, self._reader, self.options.threads)
            if point.stride > self.options.horizon:
                raise UserError(
                    f"--horizon is {self.options.horizon}, and {point.label} steps {point.stride} "
                    f"frames at once; set --horizon {point.stride} or more."
                )
            self.points.append(point)

    def _train(self) -> None:
        """Train the networks that are not trained yet, and add them as points."""
        options = self.options
        trained = []
        for it in options.trainings:
            folder, steps = self.folder / "models" / it.label, options.budget
            note = folder.with_name("seconds.json")
            limits = {
                "max_epochs": -1,
                "max_steps": steps,
                "val_check_interval": max(steps // 4, 1),
                "check_val_every_n_epoch": "null",
            }
            given = [f"--trainer.{name}={value}" for name, value in limits.items()]
            configs = [*map(Path, it.configs)]
            training = Training(folder, configs, [*given, *it.options], options.threads)
            seconds = json.loads(note.read_text()) if note.exists() else {}
            if it.label not in seconds:
                print(f"training {it.label}, {steps} batches (log: {folder}/fit.log)", flush=True)
                began = time.perf_counter()
                training.run("fit")
                seconds[it.label] = time.perf_counter() - began
                write_whole(note, json.dumps(seconds))
            self._training[it.label] = seconds[it.label]
            trained.append(ModelPoint(str(folder), label=it.label))
        self._add_models(trained)

    def _engine(self) -> Engine:
        options = self.options
        if options.scheduler or options.workers > 1:
            return Cluster(options.scheduler, options.workers)
        return InTurn()

    def _stored(self, task: Task) -> Measured | None:
        """Return the results of a task that is finished."""
        path = self._path(task)
        if not path.exists():
            return None
        return measured_from(json.loads(path.read_text())["results"])

    def _store(self, task: Task, measured: Measured) -> None:
        path = self._path(task)
        stored = {
            "label": task.point.label,
            "simulation": task.simulation,
            "settings": task.point.settings,
            "results": asdict(measured),
        }
        write_whole(path, json.dumps(stored, indent=1))

    def _path(self, task: Task) -> Path:
        """Return the file of a task's results, whose name changes with what they depend on."""
        status = self._reader.path.stat()
        depends = {
            "point": task.point.settings,
            "measure": {name: getattr(self.options, name) for name in _MEASURE},
            "data": [str(self._reader.path.resolve()), status.st_size, status.st_mtime],
            "simulation": task.simulation,
        }
        key = sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()[:16]
        return self.folder / "points" / f"{key}.json"
