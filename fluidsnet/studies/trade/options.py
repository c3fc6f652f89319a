"""Options of the trade study, and the points that it measures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, Self

from datamodules.generate.job import PARAMETERS, SOLVER_STEPS, SolverName
from fluidsnet.errors import UserError
from fluidsnet.studies.machine import cores

#: Precision of a network: as it was trained, or torch's autocast.
Precision = Literal["32-true", "bf16-mixed", "16-mixed"]


@dataclass(frozen=True)
class SolverPoint:
    """The solver with a step and a tolerance.

    Attributes:
        solver: WCSPH, PCISPH, PBF, IISPH or DFSPH.
        step: Time step, s; divides the frame interval of the data or is a multiple of it.
        tolerance: Mean error of the density at which a step is solved, per cent.
        coarsen: Factor of the particle radius. Above 1 the solver samples the scene anew, has a
            rollout alone, and is compared through the density field.
    """

    solver: SolverName = "DFSPH"
    step: float = 0.005
    tolerance: float = 0.05
    coarsen: float = 1.0

    def __post_init__(self) -> None:
        for name in ("step", "tolerance", "coarsen"):
            if not getattr(self, name) > 0:
                raise UserError(f"solvers: {name} is {getattr(self, name)}; set it above zero.")

    @property
    def label(self) -> str:
        """Name in the tables."""
        parts = [f"{self.solver} {1000 * self.step:g} ms"]
        if "maxError" in PARAMETERS[self.solver]:
            parts.append(f"{self.tolerance:g}%")
        if self.coarsen != 1:
            parts.append(f"{self.coarsen:g} radii")
        return ", ".join(parts)


@dataclass(frozen=True)
class ModelPoint:
    """A trained model, or a prior alone.

    Attributes:
        model: Folder of a run, name of a shipped model, or config file of a prior alone.
        stride: Frames in a step, for models without a time step of their own.
        label: Name in the tables; by default what `model` names.
        prior: Arguments of a prior alone in place of those of the config.
        neighbors: Greatest number of neighbors of a network; by default as trained.
        precision: Precision of a network.
        compiled: Compile a network with torch.compile.
    """

    model: str
    stride: int = 1
    label: str = ""
    prior: dict[str, int | float] = field(default_factory=dict)
    neighbors: int | None = None
    precision: Precision = "32-true"
    compiled: bool = False

    def __post_init__(self) -> None:
        for name in ("stride", "neighbors"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise UserError(f"models: {name} is {value}; it must be at least 1.")

    @property
    def name(self) -> str:
        """Name in the tables."""
        return self.label or self.model


@dataclass(frozen=True)
class Training:
    """A network to train for the study; it is measured as a model.

    Attributes:
        label: Name in the tables, and of the folder of its run.
        configs: Config files of `fluidsnet fit`, in their order.
        options: Further options of `fluidsnet fit`, such as --model.init_args.head=[64].
    """

    label: str
    configs: list[str]
    options: list[str] = field(default_factory=list)


def _careless() -> list[SolverPoint]:
    steps = ((SOLVER_STEPS["DFSPH"], 0.05), (0.005, 0.05), (0.005, 1.0), (0.01, 1.0), (0.02, 1.0))
    return [SolverPoint("DFSPH", *values) for values in steps]


@dataclass(frozen=True)
class TradeOptions:
    """Options of the trade study.

    Attributes:
        data: Data file with held-out simulations; the solver can continue those that `generate`
            drew.
        solvers: Solver, step in s and tolerance in per cent of each point; [] for none.
        models: Models to measure: folder of a run, name of a shipped model or config of a prior
            alone, and its label.
        trainings: Networks to train first, each in a folder of the output; those that are
            finished are not trained again.
        budget: Batches that each of them is trained on.
        simulations: Number of simulations, from the first in the file.
        every: Frames from one true state to the next of those that errors of a few frames start
            from.
        horizon: Frames that each of them is continued.
        steps: Frames of the rollout of each simulation, from its first frame on.
        marks: Frames after which the rollout is measured.
        floor: Measure the floor of chaos: the solver of the data with a start that is moved by
            a thousandth of a radius, and with half its step.
        threads: Threads of solver and models; all cores by default.
        output: Folder for the tables and for the points that are finished, which are not measured
            again.
        quick: One simulation, fewer true states and at most 25 frames, for a first look.
        workers: Processes that measure at once, each with its threads; more than one needs the
            extra `cluster`.
        scheduler: Address of a running Dask scheduler to measure on, such as tcp://host:8786;
            its workers must see the same files.
    """

    data: str = "data/box_drops/test.h5"
    solvers: list[SolverPoint] = field(default_factory=_careless)
    models: list[ModelPoint] = field(default_factory=list)
    trainings: list[Training] = field(default_factory=list)
    budget: int = 2000
    simulations: int = 4
    every: int = 10
    horizon: int = 8
    steps: int = 100
    marks: list[int] = field(default_factory=lambda: [5, 12, 25, 50, 100])
    floor: bool = True
    threads: int = field(default_factory=cores)
    output: str = "runs/trade"
    quick: bool = False
    workers: int = 1
    scheduler: str = ""

    def __post_init__(self) -> None:
        for name in ("budget", "simulations", "every", "horizon", "steps", "workers"):
            if getattr(self, name) < 1:
                raise UserError(f"--{name} is {getattr(self, name)}; it must be at least 1.")
        if not 1 <= self.threads <= cores():
            raise UserError(f"--threads is {self.threads}; this process can use {cores()} cores.")
        if not self.marks or any(not 1 <= mark <= self.steps for mark in self.marks):
            raise UserError(
                f"--marks is {self.marks}; give frames from 1 to --steps, {self.steps}."
            )

    def reduced(self) -> Self:
        """Return the options of a first look if that is asked for."""
        if not self.quick:
            return self
        steps = min(self.steps, 25)
        marks = [mark for mark in self.marks if mark <= steps] or [steps]
        return replace(
            self, simulations=1, every=max(self.every, 4 * self.horizon), steps=steps, marks=marks,
            budget=min(self.budget, 20),
        )  # fmt: skip
