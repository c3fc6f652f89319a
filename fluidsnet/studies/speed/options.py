"""Options of ``fluidsnet speed``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import torch

from fluidsnet.errors import UserError
from fluidsnet.studies.machine import cores

Precision = Literal["float32", "bfloat16", "float16"]


@dataclass(frozen=True)
class SpeedOptions:
    """What to measure.

    Attributes:
        particles: Numbers of fluid particles. For each, the study takes the dam break of whole
            particle layers that is nearest.
        threads: Threads of the network and of the solver; all cores by default.
        repeats: Number of timed steps of each measurement.
        neighbors: Neighbor searches of the network: Auto (stores no edges on the CPU),
            CellListCPU, CellList, TorchCluster.
        precision: float32, bfloat16, float16; the last two by autocast. The first two searches
            are measured in all of them, the other searches in the first only.
        compile: Measure the first two searches also with torch.compile, in float32.
        solvers: IISPH, DFSPH or none. The network steps states that the first one computed.
        frames: Frames that the solver computes after its start; their median is reported.
        time_step: Step of the network and interval between frames of the solver, s.
        solver_step: Time step of the solver, s; divides time_step.
        batch: Number of known frames predicted at once (Table 3 of the paper); 0 skips it.
        model: Config file of a network, such as configs/model/field.yaml, measured with random
            weights; the paper's network by default.
        run: Folder of a training run whose network is measured in place of model.
        device: Device of the network, cpu or cuda.
        seconds: Approximate time limit of a measurement, s. Sizes that would exceed it are
            skipped.
        output: Folder for speed.md, speed.csv and speed.png.
    """

    particles: list[int] = field(
        default_factory=lambda: [1000, 4000, 30000, 125000, 300000, 618043, 2000000]
    )
    threads: int = field(default_factory=cores)
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
        if not 1 <= self.threads <= cores():
            raise UserError(
                f"--threads is {self.threads}; this process can use 1 to {cores()} cores."
            )
        if self.batch < 0:
            raise UserError(f"--batch is {self.batch}; give a number of frames, or 0 to skip it.")
        if self.model is not None and self.run is not None:
            raise UserError("--model and --run both name a network; give only one of them.")
        if not self.neighbors or not self.precision:
            raise UserError("--neighbors and --precision need at least one name each.")
        try:
            kind = torch.device(self.device).type
        except RuntimeError as error:
            raise UserError(f"--device {self.device} is no device; use cpu or cuda.") from error
        if kind not in ("cpu", "cuda"):
            raise UserError(f"--device {self.device} cannot be measured; use cpu or cuda.")
        if kind == "cuda" and not torch.cuda.is_available():
            raise UserError("--device cuda needs a CUDA GPU, and torch finds none; use cpu.")
