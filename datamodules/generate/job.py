"""What one solver process is told to do."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Literal

from datamodules.generate.scenes import Block, Body, Drop, Vector

SolverName = Literal["WCSPH", "PCISPH", "IISPH", "DFSPH"]


@dataclass(frozen=True)
class Job:
    """What one process needs to know.

    Attributes:
        output: the file to leave when the simulation is whole.
        scene: name of the scene kind.
        solver: the pressure solver.
        domain: edges of the box, m; its lower corner is the origin.
        particle_radius: m.
        gravity: m/s².
        density0: kg/m³.
        viscosity: coefficient of the solver's standard viscosity.
        solver_step: the solver's time step, s.
        steps_per_frame: solver steps between two stored frames.
        frames: number of stored frames, the start included.
        seed: entropy of this simulation's random generator.
        bodies: the fluid at the start.
        threads: OpenMP threads.
        parameters: the pressure solver's own parameters, as it names them.
    """

    output: str
    scene: str
    solver: SolverName
    domain: Vector
    particle_radius: float
    gravity: Vector
    density0: float
    viscosity: float
    solver_step: float
    steps_per_frame: int
    frames: int
    seed: list[int]
    bodies: list[Body]
    threads: int
    parameters: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> str:
        """The job as text."""
        bodies = [body.describe() for body in self.bodies]
        return json.dumps({**asdict(self), "bodies": bodies})

    @classmethod
    def from_json(cls, text: str) -> Job:
        """The job from its text."""
        values = json.loads(text)
        shapes = {"block": Block, "drop": Drop}
        values["bodies"] = [shapes[body.pop("shape")](**body) for body in values["bodies"]]
        return cls(**values)
