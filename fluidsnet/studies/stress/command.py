"""``fluidsnet stress``: numerical stability of a model in hard cases."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import final

from datamodules.generate.job import SolverName
from datamodules.generate.solver import load_solver
from fluidsnet.errors import UserError
from fluidsnet.folder_lock import FolderLock
from fluidsnet.model import Model
from fluidsnet.models import load
from fluidsnet.particles import Particles
from fluidsnet.progress import Progress
from fluidsnet.stress.cases import Case, cases, dam
from fluidsnet.stress.outcome import Outcome, judge, model_states
from fluidsnet.stress.report import Table, draw_failure, write_report
from fluidsnet.stress.runs import run_case
from fluidsnet.stress.scenes import Setting
from fluidsnet.stress.sensitivity import (
    growth_rows,
    header,
    moved,
    precision_rows,
)
from fluidsnet.studies.machine import cores, cpu_model, versions
from fluidsnet.studies.parser import parse_options
from fluidsnet.studies.stress.solver import solver_states


@final
@dataclass(frozen=True)
class StressOptions:
    """Options of the stress study.

    Attributes:
        run: Folder of a run, name of a shipped model, or config file of a prior alone.
        radius: Particle radius of the scenes, m; that of the training data.
        time_step: Time step of a model that takes any, s; others have their own.
        viscosity: Coefficient of viscosity of the scenes; that of the training data.
        steps: Steps of each case.
        rest_steps: Steps of the cases that come to rest: a pool, and a dam break.
        solver: Pressure solver to run on the same cases, at its own step; null for none.
        solver_steps: Time steps of a case that the solver computes, at most.
        largest: Particles of the largest case, such as 2000000; 0 for none.
        cases: Words that a case's name must have one of; all cases by default.
        threads: Threads of the solver.
        output: Folder for tables and pictures; by default runs/stress/ and the model's name.
    """

    run: str
    radius: float = 0.025
    time_step: float = 0.02
    viscosity: float = 0.01
    steps: int = 200
    rest_steps: int = 10_000
    solver: SolverName | None = "DFSPH"
    solver_steps: int = 100
    largest: int = 0
    cases: list[str] = field(default_factory=list)
    threads: int = field(default_factory=cores)
    output: str = ""

    def __post_init__(self) -> None:
        for name in ("radius", "time_step", "steps", "rest_steps", "solver_steps", "threads"):
            if not getattr(self, name) > 0:
                raise UserError(f"--{name} is {getattr(self, name)}; set it above zero.")
        for name in ("viscosity", "largest"):
            if not getattr(self, name) >= 0:
                raise UserError(f"--{name} is {getattr(self, name)}; set at least 0.")


def stress_command(arguments: list[str]) -> None:
    """Run the study and print its table.

    Raises:
        UserError: An option cannot be used, the model cannot be loaded, or the solver is needed
            and not installed.
    """
    options = parse_options(
        "stress",
        "Roll a model out in hard cases (rest, depth, other time steps, speeds, viscosities and "
        "gravities, few particles, none, wrong places, other units and precisions), beside its "
        "prior and the solver, and say where it is stable, degrades or blows up. "
        "A first try: fluidsnet stress --run box_drops --rest_steps 500",
        StressOptions,
        arguments,
    )
    if options.solver is not None:
        load_solver()
    folder = Path(options.output or Path("runs") / "stress" / Path(options.run).stem)
    with FolderLock(folder):
        print(stress(load(options.run), options, folder))
    print(f"Written to {folder}: stress.md, stress.csv and stress.png.")


def stress(model: Model, options: StressOptions, folder: Path) -> str:
    """Run the study, write its files to a folder, and return its text.

    Args:
        model: Model in evaluation mode, on the CPU.
        options: What to run.
        folder: Folder of the results.

    Raises:
        UserError: No case has one of the words.
    """
    setting = Setting(
        options.radius, float(model.time_step) or options.time_step, options.viscosity
    )
    chosen = [
        case
        for case in cases(setting, options.steps, options.rest_steps, options.largest)
        if not options.cases or any(word in case.name for word in options.cases)
    ]
    if not chosen:
        raise UserError(f"--cases is {options.cases}; no case has one of these words.")
    outcomes: dict[str, dict[str, Outcome]] = {}
    worst: tuple[Case, Outcome] | None = None
    with Progress(total=len(chosen), unit="case") as bar:
        for case in chosen:
            bar.set_description(case.name)
            made = run_case(case, model, bar.refresh)
            if case.solver and options.solver is not None:
                made["solver"] = _by_solver(case, options.solver, options, bar.refresh)
            outcomes[case.name], found = made, made["model"]
            if worst is None and found.verdict == "blows up" and found.last is not None:
                worst = case, found
            bar.update()
            if case.expected and found.verdict != "stable":
                bar.write(f"WARNING: {case.name}: {found.verdict}.", sys.stderr)
    tables = [] if options.cases else _tables(model, setting, options)
    notes = [
        f"{datetime.now():%Y-%m-%d}, {cpu_model()}; {versions()}",
        f"{options.run}: time step {1000 * setting.time_step:g} ms, particle radius "
        f"{setting.radius:g} m, viscosity {setting.viscosity:g}",
    ]
    text = write_report(folder, notes, outcomes, tables)
    if worst is not None:
        case, found = worst
        draw_failure(folder / "failure.png", case.name, case.make(), found)
    return text


def _by_solver(
    case: Case, solver: SolverName, options: StressOptions, advance: Callable[[], None]
) -> Outcome:
    """Return the outcome of a case for the solver."""
    start, steps = case.make(), min(case.steps, options.solver_steps)
    states = solver_states(start, steps, solver, options.threads, advance)
    return judge(start, states, steps, case.closed)


def _tables(model: Model, setting: Setting, options: StressOptions) -> list[Table]:
    """Return the tables of precisions and of the growth of small changes."""
    start, steps = dam(setting), min(options.steps, 100)

    def run(noise: float) -> Iterable[Particles]:
        return model_states(model, moved(start, noise), steps, lambda: None)

    columns = header(steps)
    tables: list[Table] = [
        (
            "Precision: mean distance from float64 in the dam break, radii",
            ["numbers", *columns],
            precision_rows(model, start, steps),
        ),
        (
            "Growth of a noise on the start of the dam break: mean distance, radii",
            ["noise, radii", *columns],
            growth_rows(run, start, steps),
        ),
    ]
    solver = options.solver
    if solver is not None:

        def solve(noise: float) -> Iterable[Particles]:
            return solver_states(start, steps, solver, options.threads, lambda: None, noise)

        tables.append(
            (
                f"The same of {solver}",
                ["noise, radii", *columns],
                growth_rows(solve, start, steps),
            )
        )
    return tables
