"""``fluidsnet speed``: time of a network step and of the solver against the number of particles."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import torch

from datamodules.generate.solver import load_solver
from fluidsnet.folder_lock import FolderLock
from fluidsnet.progress import Progress
from fluidsnet.studies.dam_break import Dam
from fluidsnet.studies.machine import BUSY, OtherLoad, cpu_model, versions
from fluidsnet.studies.parser import parse_options
from fluidsnet.studies.speed.floor import step_floor
from fluidsnet.studies.speed.measure import load_model
from fluidsnet.studies.speed.report import Report, Row
from fluidsnet.studies.speed.trial import Result, SpeedOptions, Trial, measure_solver, run_trial

#: Fluid particles of the scenes of the paper's Table 3.
TABLE_3_PARTICLES = (28623, 46430, 66987)


def speed_command(arguments: list[str]) -> None:
    """Run the study and print its page.

    Raises:
        UserError: An option cannot be used, or the solver is needed and not installed.
    """
    options = parse_options(
        "speed",
        "Measure the time of one network step against the number of particles, and that of "
        "SPlisHSPlasH on the same scenes with as many threads. The scenes are dam breaks whose "
        "domain grows while the particles keep the paper's size. Tables and figure are written "
        "after each measurement. Run nothing else meanwhile. "
        "A first try: fluidsnet speed --particles [1000,30000]",
        SpeedOptions,
        arguments,
    )
    study = Study(options)
    with FolderLock(study.folder):
        shutil.rmtree(study.work, ignore_errors=True)
        study.work.mkdir(parents=True)
        try:
            study.run()
        finally:
            shutil.rmtree(study.work, ignore_errors=True)
    print(f"\n{(study.folder / 'speed.md').read_text(encoding='utf-8')}")
    for warning in study.report.warnings:
        print(f"WARNING: {warning}", file=sys.stderr)
    print(f"\nWritten to {study.folder}: speed.md, speed.csv and speed.png.")


class Study:
    """All measurements, size by size; the report is written after each.

    Args:
        options: What to measure.

    Raises:
        UserError: The solver is not installed, or the network cannot be loaded.
    """

    def __init__(self, options: SpeedOptions) -> None:
        self.options, self.folder = options, Path(options.output)
        self.work = self.folder / "work"
        self.solvers: list[Any] = [solver for solver in options.solvers if solver != "none"]
        if self.solvers:
            load_solver()
        # Loaded before the solver runs, so that a wrong path costs no time.
        self.network = load_model(options, "Auto").network
        self.report = Report(self._header())

    def run(self) -> None:
        """Measure everything."""
        options, report = self.options, self.report
        with OtherLoad() as load:
            time.sleep(1.0)
        report.busy_before = load.cores
        for warning in report.warnings:
            print(f"WARNING: {warning}", file=sys.stderr)
        batches = TABLE_3_PARTICLES if options.batch else ()
        steps = len(list(self._steps(0, Path())))
        count = 1 + (1 + len(self.solvers) + steps) * len(options.particles)
        count += (1 + ("IISPH" in self.solvers)) * len(batches)
        with Progress(total=count, unit="measurement") as self._progress:
            report.cores = self._measure(Trial("cores", options))
            for particles in sorted(options.particles):
                self._measure_size(Dam.of(particles))
            for particles in batches:
                self._measure_batch(Dam.of(particles))

    def _steps(self, particles: int, states: Path) -> Iterator[Trial]:
        """Yield a measurement for each method of the network.

        A third search differs from the second in the search alone, which neither precision nor
        torch.compile changes.
        """
        options = self.options
        for index, neighbors in enumerate(options.neighbors):
            trial = partial(Trial, "step", options, particles, states, neighbors)
            for precision in options.precision[: None if index < 2 else 1]:
                yield trial(precision)
            if options.compile and index < 2:
                yield trial("float32", compile=True)

    def _measure(self, trial: Trial, run: Callable[[Trial], Result] | None = None) -> Result:
        """Return a result, with the cores that other processes kept busy meanwhile."""
        self._progress.set_description(trial.name)
        with OtherLoad() as load:
            result = (run or run_trial)(trial)
        result.others = load.cores
        if load.cores > BUSY:
            self._note(f"WARNING: others took {load.cores:.1f} cores during {trial.name}.")
        if result.failure:
            self._note(f"{trial.name}: {result.failure}")
        self._progress.update()
        return result

    def _note(self, message: str) -> None:
        self._progress.write(message, file=sys.stderr)

    def _measure_size(self, dam: Dam) -> None:
        """Measure solvers and network at one size."""
        report, particles = self.report, dam.particles
        states = self._solve(dam, self.options.frames, self.solvers, report.rows)
        reference = Trial("reference", self.options, particles, states, "CellListCPU")
        self._progress.set_description(reference.name)
        if failure := run_trial(reference).failure:
            self._note(f"{reference.name} failed, so errors are missing: {failure}")
        self._progress.update()
        results = []
        for trial in self._steps(particles, states):
            results.append(self._measure_step(trial))
            report.rows.append((trial, results[-1]))
            report.write(self.folder)
        measured = next((result for result in results if result.edges is not None), None)
        floor = measured and step_floor(self.network, particles, measured.edges or 0.0)
        if measured and floor:
            report.floors[particles] = {**floor, "step": median(measured.step)}
            report.write(self.folder)
        reference.reference.unlink(missing_ok=True)
        states.unlink()

    def _measure_step(self, trial: Trial) -> Result:
        """Measure a step, unless a smaller size shows that it would take too long."""
        limit = self.options.seconds
        smaller = [row for row in self.report.rows if row[0].label == trial.label]
        if smaller:
            before, result = smaller[-1]
            slowest = max(map(median, filter(None, (result.step, result.search))), default=0)
            expected = slowest * (trial.particles / before.particles) ** 1.2
            # One step for the memory, one for the time, three for the profiler.
            if not result.step or 5 * expected > limit:
                self._progress.update()
                return Result(failure=f"skipped: beyond {limit:g} s")
        return self._measure(trial)

    def _solve(self, dam: Dam, frames: int, solvers: list[Any], rows: list[Row]) -> Path:
        """Time the solvers, append their rows, and return the states of the first that ran."""
        options, states = self.options, self.work / f"{dam.particles}.h5"
        for solver in solvers:
            trial = Trial(solver, options, dam.particles, states)
            result = self._measure(trial, partial(measure_solver, dam, solver, frames))
            rows.append((trial, result))
            self.report.write(self.folder)
        if not states.exists():
            dam.write_start(states, frames, options.time_step)
        return states

    def _measure_batch(self, dam: Dam) -> None:
        """Measure known frames predicted at once, and the solver's frames beside them."""
        options = self.options
        solvers = [name for name in self.solvers if name == "IISPH"]
        rows: list[Row] = []
        states = self._solve(dam, max(options.frames, options.batch), solvers, rows)
        trial = Trial("batch", options, dam.particles, states, options.neighbors[0])
        result = self._measure(trial)
        states.unlink()
        for _, solver in rows:
            result.solver = median(solver.step) if solver.step else None
            result.others = max(result.others, solver.others)
        if result.step:
            self.report.batches.append((trial, result))
            self.report.write(self.folder)

    def _header(self) -> list[str]:
        options = self.options
        name = options.run or options.model or "the paper's network"
        step = f"{1000 * options.time_step:g} ms"
        cuda = options.device.startswith("cuda")
        device = torch.cuda.get_device_name(options.device) if cuda else options.device
        return [
            f"{datetime.now():%Y-%m-%d}, {cpu_model()}, {options.threads} threads each for network "
            f"and solver; network on {device}",
            versions(),
            f"network: {name}, {'trained' if options.run else 'random'} weights, "
            f"k = {self.network.neighbors.k}, {step} a step, all copies and the search included",
            f"solver: fixed steps of {1000 * options.solver_step:g} ms, {options.frames} frames "
            f"of {step} each",
            "state: the last frame of the first solver, walls included; without a solver the "
            "column at rest",
        ]
