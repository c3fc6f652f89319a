"""Options of the trade study, and the points that it measures."""

from __future__ import annotations

from dataclasses import dataclass, field

from datamodules.generate.job import PARAMETERS, SOLVER_STEPS, SolverName
from fluidsnet.errors import UserError
from fluidsnet.studies.machine import cores


@dataclass(frozen=True)
class SolverPoint:
    """The solver with a step and a tolerance.

    Attributes:
        solver: WCSPH, PCISPH, IISPH or DFSPH.
        step: Time step, s; divides the frame interval of the data or is a multiple of it.
        tolerance: Mean error of the density at which a step is solved, per cent.
    """

    solver: SolverName = "DFSPH"
    step: float = 0.005
    tolerance: float = 0.05

    def __post_init__(self) -> None:
        for name in ("step", "tolerance"):
            if not getattr(self, name) > 0:
                raise UserError(f"solvers: {name} is {getattr(self, name)}; set it above zero.")

    @property
    def label(self) -> str:
        """Name in the tables."""
        step = f"{self.solver} {1000 * self.step:g} ms"
        return step if "maxError" not in PARAMETERS[self.solver] else f"{step}, {self.tolerance:g}%"


@dataclass(frozen=True)
class ModelPoint:
    """A trained model, or a prior alone.

    Attributes:
        model: Folder of a run, name of a shipped model, or config file of a prior alone.
        stride: Frames in a step, for models without a time step of their own.
        label: Name in the tables; by default what `model` names.
        prior: Arguments of a prior alone in place of those of the config.
    """

    model: str
    stride: int = 1
    label: str = ""
    prior: dict[str, int | float] = field(default_factory=dict)


def _careless() -> list[SolverPoint]:
    steps = ((SOLVER_STEPS["DFSPH"], 0.05), (0.005, 0.05), (0.005, 1.0), (0.01, 1.0), (0.02, 1.0))
    return [SolverPoint("DFSPH", *values) for values in steps]


@dataclass(frozen=True)
class TradeOptions:
    """Options of the trade study.

    Attributes:
        data: Data file with held-out simulations of a scene that `generate` drew.
        solvers: Solver, step in s and tolerance in per cent of each point; [] for none.
        models: Models to measure: folder of a run, name of a shipped model or config of a prior
            alone, and its label.
        simulations: Number of simulations, from the first in the file.
        every: Frames from one true state to the next of those that errors of a few frames start
            from.
        horizon: Frames that each of them is continued.
        steps: Frames of the rollout of each simulation, from its first frame on.
        marks: Frames after which the rollout is measured.
        threads: Threads of solver and models; all cores by default.
        output: Folder for the tables and for the points that are finished, which are not measured
            again.
    """

    data: str = "data/box_drops/test.h5"
    solvers: list[SolverPoint] = field(default_factory=_careless)
    models: list[ModelPoint] = field(default_factory=list)
    simulations: int = 4
    every: int = 10
    horizon: int = 8
    steps: int = 100
    marks: list[int] = field(default_factory=lambda: [25, 50, 100])
    threads: int = field(default_factory=cores)
    output: str = "runs/trade"

    def __post_init__(self) -> None:
        for name in ("simulations", "every", "horizon", "steps"):
            if getattr(self, name) < 1:
                raise UserError(f"--{name} is {getattr(self, name)}; it must be at least 1.")
        if not 1 <= self.threads <= cores():
            raise UserError(f"--threads is {self.threads}; this process can use {cores()} cores.")
        if not self.marks or any(not 1 <= mark <= self.steps for mark in self.marks):
            raise UserError(
                f"--marks is {self.marks}; give frames from 1 to --steps, {self.steps}."
            )
