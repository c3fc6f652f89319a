"""``fluidsnet speed``: time of a network step and of the solver against the number of particles."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from statistics import median
from typing import Any

from datamodules.generate.solver import load_solver
from fluidsnet.progress import Progress
from fluidsnet.studies.dam_break import Dam
from fluidsnet.studies.machine import BUSY, OtherLoad, cpu_model, device_name, versions
from fluidsnet.studies.parser import study_parser
from fluidsnet.studies.speed.floor import Floor, step_floor
from fluidsnet.studies.speed.measure import load_model
from fluidsnet.studies.speed.options import Precision, SpeedOptions
from fluidsnet.studies.speed.paper import TABLE_3_PARTICLES
from fluidsnet.studies.speed.report import Report
from fluidsnet.studies.speed.table import Row
from fluidsnet.studies.speed.trial import Result, Trial, measure_solver, run_trial


def speed_command(arguments: list[str]) -> None:
    """Run the study and print its page.

    Raises:
        UserError: An option cannot be used, or the solver is needed and not installed.
    """
    parser = study_parser(
        "speed",
        "Measure the time of one network step against the number of particles, and that of "
        "SPlisHSPlasH on the same scenes with as many threads. The scenes are dam breaks whose "
        "domain grows while the particles keep the paper's size. Tables and figure are written "
        "after each measurement. Run nothing else meanwhile. "
        "A first try: fluidsnet speed --particles [1000,30000]",
        SpeedOptions,
    )
    parsed = vars(parser.parse_args(arguments))
    parsed.pop("config")
    options = SpeedOptions(**parsed)
    if any(solver != "none" for solver in options.solvers):
        load_solver()
    study = Study(options)
    shutil.rmtree(study.work, ignore_errors=True)
    study.work.mkdir(parents=True)
    try:
        study.run()
    finally:
        shutil.rmtree(study.work, ignore_errors=True)
    print(f"\n{(study.folder / 'speed.md').read_text()}")
    for warning in study.report.warnings:
        print(f"WARNING: {warning}", file=sys.stderr)
    print(f"\nWritten to {study.folder}: speed.md, speed.csv and speed.png.")


class Study:
    """All measurements, size by size; the report is written after each.

    Args:
        options: What to measure.

    Raises:
        UserError: The network cannot be loaded.
    """

    def __init__(self, options: SpeedOptions) -> None:
        self.options, self.folder = options, Path(options.output)
        self.work = self.folder / "work"
        # Loaded before the solver runs, so that a wrong path costs no time.
        self.network = load_model(options, "Auto").network
        self.report = Report()
        self._previous: dict[str, Row] = {}

    def run(self) -> None:
        """Measure everything."""
        options, report = self.options, self.report
        report.header = self._header()
        with OtherLoad() as load:
            time.sleep(1.0)
        report.busy_before = load.cores
        for warning in report.warnings:
            print(f"WARNING: {warning}", file=sys.stderr)
        solvers = [solver for solver in options.solvers if solver != "none"]
        frames = TABLE_3_PARTICLES if options.batch else ()
        count = 1 + (1 + len(solvers) + len(self._network_rows(0))) * len(options.particles)
        count += (1 + ("IISPH" in solvers)) * len(frames)
        with Progress(total=count, unit="measurement") as self._progress:
            result, others = self._measure(
                "the measurement of the cores", run_trial, self.work, Trial("cores", options)
            )
            report.floor = Floor(result.cores, others, result.failure)
            for particles in sorted(options.particles):
                self._measure_size(Dam.of(particles), solvers)
            for particles in frames:
                self._measure_batch(
                    Dam.of(particles), [name for name in solvers if name == "IISPH"]
                )

    def _measure(
        self, name: str, work: Callable[..., Result], *arguments: Any
    ) -> tuple[Result, float]:
        """Return a result and the cores that other processes kept busy meanwhile."""
        self._progress.set_description(name)
        with OtherLoad() as load:
            result = work(*arguments)
        if load.cores > BUSY:
            warning = f"WARNING: others took {load.cores:.1f} cores during {name}."
            self._progress.write(warning, file=sys.stderr)
        if result.failure:
            self._progress.write(f"{name}: {result.failure}", file=sys.stderr)
        self._progress.update()
        return result, load.cores

    def _network_rows(self, particles: int) -> list[Row]:
        """Return an empty row for each method of the network.

        A third search differs from the second in the search alone, which neither precision nor
        torch.compile changes.
        """
        options = self.options
        methods: list[tuple[str, Precision, bool]] = []
        for index, neighbors in enumerate(options.neighbors):
            precisions = options.precision[: None if index < 2 else 1]
            methods += [(neighbors, precision, False) for precision in precisions]
            if options.compile and index < 2:
                methods.append((neighbors, "float32", True))
        return [Row(particles, "network", *method, options.time_step) for method in methods]

    def _measure_size(self, dam: Dam, solvers: list[Any]) -> None:
        states = self._solve(dam, self.options.frames, solvers, self.report.rows)
        reference = self.work / "reference.npy"
        base = Trial("reference", self.options, states, "CellListCPU", reference=reference)
        self._progress.set_description(f"{dam.particles:,} particles, reference")
        failure = run_trial(self.work, base).failure
        if failure:
            self._progress.write(
                f"{dam.particles:,} particles: the reference failed, so errors are missing: "
                f"{failure}",
                file=sys.stderr,
            )
        self._progress.update()
        rows = self._network_rows(dam.particles)
        for row in rows:
            self._measure_step(row, base)
            self._previous[row.label] = row
            self.report.rows.append(row)
            self._write()
        edges = next((row.result.edges for row in rows if row.result.edges is not None), None)
        step = next((median(row.result.step) for row in rows if row.result.step), None)
        if edges is not None and step is not None:
            least = step_floor(self.network, dam.particles, edges)
            if least is not None:
                self.report.floor.steps[dam.particles] = {**least, "step": step}
                self._write()
        reference.unlink(missing_ok=True)
        states.unlink()

    def _measure_step(self, row: Row, base: Trial) -> None:
        """Fill a row in, or note that it would take too long."""
        previous = self._previous.get(row.label)
        if previous is not None:
            result = previous.result
            slowest = max(
                (median(times) for times in (result.step, result.search) if times), default=0
            )
            expected = slowest * (row.particles / previous.particles) ** 1.2
            # One step for the memory, one for the time, three for the profiler.
            if not result.step or 5 * expected > self.options.seconds:
                row.result = Result(failure=f"skipped: beyond {self.options.seconds:g} s")
                self._progress.update()
                return
        trial = replace(
            base,
            kind="step",
            neighbors=row.neighbors,
            precision=row.precision,
            compile=row.compiled,
        )
        row.result, row.others = self._measure(row.name, run_trial, self.work, trial)

    def _solve(self, dam: Dam, frames: int, solvers: list[Any], rows: list[Row]) -> Path:
        """Time the solvers, append their rows, and return the states of the first that ran."""
        options, states = self.options, self.work / f"{dam.particles}.h5"
        for solver in solvers:
            row = Row(dam.particles, solver, time_step=options.time_step)
            recipe = dam.recipe(solver, frames, options.time_step, options.solver_step)
            row.result, row.others = self._measure(
                row.name, measure_solver, recipe, self.work / solver, options.threads, states
            )
            rows.append(row)
            self._write()
        if not states.exists():
            dam.write_start(states, frames, options.time_step)
        return states

    def _measure_batch(self, dam: Dam, solvers: list[Any]) -> None:
        """Measure known frames predicted at once, and the solver's frames beside them."""
        options, count = self.options, self.options.batch
        solver_rows: list[Row] = []
        states = self._solve(dam, max(options.frames, count), solvers, solver_rows)
        row = Row(dam.particles, "network", options.neighbors[0], frames=count)
        trial = Trial("batch", options, states, row.neighbors)
        row.result, row.others = self._measure(row.name, run_trial, self.work, trial)
        states.unlink()
        for solver in solver_rows:
            row.solver = median(solver.result.step) if solver.result.step else None
            row.others = max(row.others, solver.others)
        if row.result.step:
            self.report.batches.append(row)
            self._write()

    def _write(self) -> None:
        self.report.write(self.folder)

    def _header(self) -> list[str]:
        options = self.options
        name = options.run or options.model or "the paper's network"
        step = f"{1000 * options.time_step:g} ms"
        return [
            f"{datetime.now():%Y-%m-%d}, {cpu_model()}, {options.threads} threads each for network "
            f"and solver; network on {device_name(options.device)}",
            versions(),
            f"network: {name}, {'trained' if options.run else 'random'} weights, "
            f"k = {self.network.neighbors.k}, {step} a step, all copies and the search included",
            f"solver: fixed steps of {1000 * options.solver_step:g} ms, {options.frames} frames "
            f"of {step} each",
            "state: the last frame of the first solver, walls included; without a solver the "
            "column at rest",
        ]
