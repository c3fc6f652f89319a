"""One run of the speed study: size by size, way by way."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, NoReturn

from tqdm import tqdm

from fluidsnet.errors import UserError
from fluidsnet.studies.cores import floor
from fluidsnet.studies.dam_break import Dam
from fluidsnet.studies.machine import BUSY, OtherLoad, cpu_model, device_name, versions
from fluidsnet.studies.model import load_model
from fluidsnet.studies.own_process import in_own_process
from fluidsnet.studies.paper_tables import BATCHES
from fluidsnet.studies.speed_batch import Batch
from fluidsnet.studies.speed_figure import draw
from fluidsnet.studies.speed_floor import Floor
from fluidsnet.studies.speed_report import Report
from fluidsnet.studies.speed_row import Row, spread
from fluidsnet.studies.speed_solver import time_solver
from fluidsnet.studies.trial import Trial


@dataclass
class Run:
    """Measures all that `SpeedOptions` asks for; the attributes are its, and two more.

    Attributes:
        work: folder for the solver's files, which are removed after each size.
        report: what was measured so far.
    """

    particles: list[int]
    threads: int
    repeats: int
    neighbors: list[str]
    precision: list[Any]
    compile: bool
    solvers: list[Any]
    frames: int
    time_step: float
    solver_step: float
    batch: int
    model: str | None
    run: str | None
    device: str
    seconds: float
    output: str
    work: Path
    report: Report = field(default_factory=Report)

    def __post_init__(self) -> None:
        self.solvers = [solver for solver in self.solvers if solver != "none"]
        self._before: dict[str, Row] = {}
        # Found out now, and not after the solver has run.
        self._network = load_model(self.model, self.run, "Auto", self.time_step).model.network

    def measure(self) -> None:
        """Measures, and writes tables and figure after each measurement."""
        self.report.header = self._header()
        with OtherLoad() as before:
            time.sleep(1.0)
        self.report.busy_before = before.cores
        for words in self.report.warnings:
            print(f"WARNING: {words}", file=sys.stderr)
        sizes = sorted(self.particles)
        scenes = [particles for _, particles, *_ in BATCHES] if self.batch else []
        each = 1 + len(self.solvers) + len(list(self._ways()))
        with tqdm(total=1 + each * len(sizes) + 2 * len(scenes), unit="measurement") as bar:
            bar.set_description("what the cores can do")
            self.report.floor = self._cores()
            bar.update()
            for size in sizes:
                self._size(Dam.of(size), bar)
            for size in scenes:
                self._batch(Dam.of(size), bar)
        self._write()

    def _ways(self) -> Iterator[tuple[str, Any, bool]]:
        """Search, precision, and whether torch.compile has its turn.

        A third search differs from the second in the search alone, which neither precision nor
        torch.compile changes.
        """
        for number, neighbors in enumerate(self.neighbors):
            few = number > 1
            for precision in self.precision[:1] if few else self.precision:
                yield neighbors, precision, False
            if self.compile and not few:
                yield neighbors, "float32", True

    def _cores(self) -> Floor:
        with OtherLoad() as load:
            result = in_own_process(self.work, Trial("cores", threads=self.threads))
        if result.failure:
            tqdm.write(f"no floor, since the measurement of the cores: {result.failure}")
            return Floor(note=result.failure)
        _warn("the measurement of the cores", load.cores)
        return Floor(result.cores, load.cores)

    def _size(self, dam: Dam, bar: tqdm[NoReturn]) -> None:
        rows, states = self._solve(dam, self.frames, self.solvers, bar)
        reference = self.work / "reference.npy"
        base = self._trial(states, kind="reference", reference=str(reference))
        bar.set_description(f"{dam.particles:,} particles, reference")
        failed = in_own_process(self.work, replace(base, neighbors="CellListCPU")).failure
        if failed:
            tqdm.write(f"{dam.particles:,} particles: no errors, since the reference: {failed}")
        bar.update()
        for neighbors, precision, compiled in self._ways():
            row = Row(dam.particles, 0, "network", neighbors, precision, compiled, self.time_step)
            bar.set_description(f"{dam.particles:,} particles, {row.way}")
            trial = replace(
                base, kind="step", neighbors=neighbors, precision=precision, compile=compiled
            )
            self._step(row, trial)
            self._before[row.way] = row
            rows.append(row)
            self.report.rows.append(row)
            self._write()
            bar.update()
        known = next((row for row in rows if row.edges is not None), None)
        first = next((row for row in rows if row.who == "network" and row.step), None)
        if known is not None and known.edges is not None and first is not None and first.step:
            least = floor(self._network, dam.particles, known.edges)
            if least is not None:
                self.report.floor.steps[dam.particles] = {**least, "step": first.step[0]}
        self._write()
        reference.unlink(missing_ok=True)
        states.unlink()

    def _step(self, row: Row, trial: Trial) -> None:
        """Fills in the row of a way, or its note where it would take too long."""
        before = self._before.get(row.way)
        if before is not None:
            slowest = max(
                [values[0] for values in (before.step, before.search) if values], default=0.0
            )
            expected = slowest * (row.particles / before.particles) ** 1.2
            # A step to see the memory, one to time, three to profile.
            if not before.step or 5 * expected > self.seconds:
                row.note = f"skipped: beyond {self.seconds:g} s"
                return
        with OtherLoad() as load:
            result = in_own_process(self.work, trial)
        row.others, row.note = load.cores, result.failure
        row.solids, row.peak, row.error = result.solids, result.peak, result.error
        row.stages, row.edges = result.stages, result.edges
        row.step = spread(result.step) if result.step else None
        row.search = spread(result.search) if result.search else None
        _warn(f"{row.particles:,} particles, {row.way}", row.others)

    def _solve(
        self, dam: Dam, frames: int, solvers: list[Any], bar: tqdm[NoReturn]
    ) -> tuple[list[Row], Path]:
        """The solvers' rows, and the file of the first that did not fail."""
        rows = []
        states = self.work / f"{dam.particles}.h5"
        for solver in solvers:
            bar.set_description(f"{dam.particles:,} particles, {solver}")
            row = Row(dam.particles, 0, solver, time_step=self.time_step)
            root = self.work / f"{solver}-{dam.particles}"
            try:
                recipe = dam.recipe(solver, frames, self.time_step, self.solver_step)
                time_solver(row, recipe, root, self.threads, states)
            except UserError as error:
                row.note = f"failed: {error}"
                tqdm.write(f"{dam.particles:,} particles, {solver}: {error}")
            _warn(f"{row.particles:,} particles, {row.way}", row.others)
            rows.append(row)
            self.report.rows.append(row)
            self._write()
            bar.update()
        if not states.exists():
            dam.write_start(states, frames, self.time_step)
        return rows, states

    def _batch(self, dam: Dam, bar: tqdm[NoReturn]) -> None:
        """Many frames at once; the solver's rows are not of the main table."""
        rows = list(self.report.rows)
        solvers = [solver for solver in self.solvers if solver == "IISPH"]
        made, states = self._solve(dam, max(self.frames, self.batch), solvers, bar)
        self.report.rows = rows
        bar.set_description(f"{dam.particles:,} particles, {self.batch} frames at once")
        bar.update(2 - len(made))
        trial = self._trial(states, kind="batch", neighbors=self.neighbors[0], batch=self.batch)
        with OtherLoad() as load:
            result = in_own_process(self.work, trial)
        states.unlink()
        if not result.step:
            tqdm.write(f"{dam.particles:,} particles, {self.batch} at once: {result.failure}")
            return
        solver = next((row.step[0] for row in made if row.step), None)
        batch = Batch(
            dam.particles, self.batch, spread(result.step), result.batches, result.peak or 0,
            solver, max([load.cores, *(row.others for row in made)]),
        )  # fmt: skip
        _warn(f"{dam.particles:,} particles, {self.batch} frames at once", load.cores)
        self.report.batches.append(batch)
        self._write()

    def _trial(self, states: Path, **more: Any) -> Trial:
        return Trial(
            states=str(states),
            model=self.model,
            run=self.run,
            device=self.device,
            threads=self.threads,
            repeats=self.repeats,
            seconds=self.seconds,
            **more,
        )

    def _header(self) -> list[str]:
        what = self.run or self.model or "the paper's network"
        weights = "trained" if self.run else "random"
        return [
            f"{datetime.now():%Y-%m-%d}, {cpu_model()}, {self.threads} threads each for network "
            f"and solver; network on {device_name(self.device)}",
            versions(),
            f"network: {what}, {weights} weights, k = {self._network.neighbors.k}, "
            f"{1000 * self.time_step:g} ms a step, all copies and the search included",
            f"solver: fixed steps of {1000 * self.solver_step:g} ms, "
            f"{self.frames} frames of {1000 * self.time_step:g} ms each",
            "state: the last frame of the first solver, walls included; without a solver the "
            "column at rest",
        ]

    def _write(self) -> None:
        folder = Path(self.output)
        self.report.write(folder)
        if any(row.step for row in self.report.rows):
            draw(self.report.rows, folder / "speed.png")


def _warn(what: str, others: float) -> None:
    if others > BUSY:
        tqdm.write(f"WARNING: others took {others:.1f} cores during {what}.", file=sys.stderr)
