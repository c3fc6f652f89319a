"""``fluidsnet speed``: how long a step takes, beside the solver, on one machine in one run."""

from __future__ import annotations

import shutil
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import torch

from datamodules.generate.solver import load_solver
from fluidsnet.errors import UserError
from fluidsnet.studies.machine import cores
from fluidsnet.studies.parser import Parser, study_parser
from fluidsnet.studies.speed_run import Run
from fluidsnet.studies.trial import Precision


@dataclass(frozen=True)
class SpeedOptions:
    """What to measure.

    Attributes:
        particles: sizes, about so many fluid particles each; a dam break of whole layers that
            is nearest is taken.
        threads: of the network and of the solver; all cores by default.
        repeats: how often a step is timed.
        neighbors: searches of the network: Auto (no edge is stored on the CPU), CellListCPU,
            CellList, TorchCluster.
        precision: float32, and autocast to bfloat16 or float16; all of them with the first two
            searches, the first of them with the others.
        compile: measure the first two searches in float32 through torch.compile, too.
        solvers: IISPH, DFSPH, or none; the first makes the states that the network steps.
        frames: of the solver, after its start; their median counts.
        time_step: s that a network steps, and between two of the solver's frames.
        solver_step: s; divides time_step.
        batch: known frames predicted at once, as in the paper's Table 3; 0 leaves it out.
        model: a file such as configs/model/field.yaml, with random weights; the paper's
            network by default.
        run: the folder of a training run, in place of it.
        device: of the network, cpu or cuda.
        seconds: a measurement may take about so long; larger sizes are skipped.
        output: folder for speed.md, speed.csv and speed.png.
    """

    particles: list[int] = field(
        default_factory=lambda: [1000, 4000, 30000, 125000, 300000, 618043, 2000000]
    )
    threads: int | None = None
    repeats: int = 7
    neighbors: list[Literal["Auto", "CellListCPU", "CellList", "TorchCluster"]] = field(
        default_factory=lambda: ["Auto", "TorchCluster", "CellList"]
    )
    precision: list[Precision] = field(default_factory=lambda: ["float32"])
    compile: bool = False
    solvers: list[Literal["IISPH", "DFSPH", "none"]] = field(
        default_factory=lambda: ["IISPH", "DFSPH"]
    )
    frames: int = 5
    time_step: float = 0.02
    solver_step: float = 0.004
    batch: int = 8
    model: str | None = None
    run: str | None = None
    device: str = "cpu"
    seconds: float = 120.0
    output: str = "runs/speed"

    def __post_init__(self) -> None:
        for name in ("repeats", "frames", "time_step", "solver_step", "seconds"):
            if not getattr(self, name) > 0:
                raise UserError(f"--{name} is {getattr(self, name)}; it must be above zero.")
        ratio = self.time_step / self.solver_step
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
            raise UserError(
                f"--time_step ({self.time_step} s) must be a whole number of solver steps "
                f"(--solver_step {self.solver_step} s)."
            )
        if not self.particles or min(self.particles) < 100:
            raise UserError("--particles takes numbers from 100 on, such as [1000,30000].")
        if self.threads is not None and not 1 <= self.threads <= cores():
            raise UserError(f"--threads is {self.threads}; there are {cores()} cores.")
        if self.batch < 0:
            raise UserError(f"--batch is {self.batch}; it is a number of frames, or 0 for none.")
        if self.model is not None and self.run is not None:
            raise UserError("--model and --run both name a network; give one of them.")
        if not self.neighbors or not self.precision:
            raise UserError("--neighbors and --precision each need one name at least.")
        try:
            found = torch.device(self.device)
        except RuntimeError as error:
            raise UserError(f"--device {self.device} is no device; use cpu or cuda.") from error
        if found.type not in ("cpu", "cuda"):
            raise UserError(f"--device {self.device} cannot be measured; use cpu or cuda.")
        if found.type == "cuda" and not torch.cuda.is_available():
            raise UserError("--device cuda needs a CUDA GPU, and torch finds none.")


def speed_command(arguments: list[str]) -> None:
    """Measures what the options say; tables and figure are written after each measurement.

    Raises:
        UserError: an option cannot be used, or the solver is asked for and not installed.
    """
    parsed = _parser().parse_args(arguments)
    options = SpeedOptions(
        **{name: value for name, value in vars(parsed).items() if name != "config"}
    )
    if any(solver != "none" for solver in options.solvers):
        load_solver()
    folder = Path(options.output)
    work = folder / "work"
    run = Run(**{**asdict(options), "threads": options.threads or cores()}, work=work)
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    try:
        run.measure()
    finally:
        shutil.rmtree(work, ignore_errors=True)
    print(f"\n{(folder / 'speed.md').read_text()}")
    for warning in run.report.warnings:
        print(f"WARNING: {warning}", file=sys.stderr)
    print(f"\n{folder}/speed.md, speed.csv and speed.png hold it.")


def _parser() -> Parser:
    return study_parser(
        "speed",
        (
            "Measures how long one step of a network takes against the number of particles, "
            "beside SPlisHSPlasH on the same scenes with the same threads: dam breaks whose "
            "domain grows while the particles stay the paper's. Tables and figure are written "
            "after each measurement. Nothing else should run meanwhile. "
            "A first try: fluidsnet speed --particles [1000,30000]"
        ),
        SpeedOptions,
    )
