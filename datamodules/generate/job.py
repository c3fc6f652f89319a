"""Job of one solver process, and its scene file in SPlisHSPlasH's format."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from datamodules.generate.bodies import Block, Body, Drop, describe, from_description
from datamodules.generate.mesh import write_box, write_drop
from datamodules.generate.particle_file import write_bgeo
from datamodules.schema import Header, SceneAttributes

SolverName = Literal["WCSPH", "PCISPH", "IISPH", "DFSPH"]

#: SPlisHSPlasH's numbers of its pressure solvers.
METHODS: dict[str, int] = {"WCSPH": 0, "PCISPH": 1, "IISPH": 3, "DFSPH": 4}

#: Default parameters of each pressure solver, from the example scenes of SPlisHSPlasH: the
#: tolerance in per cent of the rest density, and the stiffness of WCSPH. With SPlisHSPlasH's
#: default stiffness, a thousandth of it, the fluid falls through the floor.
PARAMETERS: dict[SolverName, dict[str, float]] = {
    "WCSPH": {"stiffness": 50000, "exponent": 7},
    "PCISPH": {"maxIterations": 100, "maxError": 0.05},
    "IISPH": {"maxIterations": 100, "maxError": 0.05},
    "DFSPH": {"maxIterations": 100, "maxError": 0.05, "maxIterationsV": 100, "maxErrorV": 0.1},
}

#: Default time step of each pressure solver, s. In a step of WCSPH, which has no pressure
#: solve, sound (19 m/s at its stiffness) may cross 0.4 of a particle.
SOLVER_STEPS = {"WCSPH": 0.0005, "PCISPH": 0.0025, "IISPH": 0.0025, "DFSPH": 0.0025}

#: Boundary handling of Akinci et al. 2012, which has boundary particles.
AKINCI_2012 = 0
#: Walls sampled on a regular triangle grid, the paper's "uniform sampling".
REGULAR_TRIANGLES = 1


@dataclass(frozen=True)
class Job:
    """Settings of one simulation."""

    output: str  # file to write once the simulation is complete
    header: Header  # attributes of the file, without those that only the solver's process knows
    scene: SceneAttributes  # attributes of the simulation
    solver_step: float  # time step of the solver, s
    steps_per_frame: int  # solver steps between two stored frames
    frames: int  # number of stored frames, the start included
    seed: list[int]  # of the random generator that drew the scene
    bodies: list[Body]  # fluid at the start
    threads: int  # OpenMP threads
    parameters: dict[str, float]  # of the pressure solver, under SPlisHSPlasH's names

    def to_json(self) -> str:
        """Return the job as JSON text."""
        return json.dumps({**asdict(self), "bodies": [describe(body) for body in self.bodies]})

    @classmethod
    def from_json(cls, text: str) -> Job:
        """Return the job that `to_json` wrote."""
        values = json.loads(text)
        values["header"] = Header(**values["header"])
        values["scene"] = SceneAttributes(**values["scene"])
        values["bodies"] = [*map(from_description, values["bodies"])]
        return cls(**values)


def scene_file(job: Job, folder: Path) -> dict[str, Any]:
    """Return a job as a SPlisHSPlasH scene, and write the files that it needs to a folder."""
    header, scene, radius = job.header, job.scene, job.header.particle_radius
    walls = folder / "walls.obj"
    write_box(walls, scene.domain_upper)
    blocks, models = [], []
    for number, body in enumerate(job.bodies):
        if isinstance(body, Block):
            # SPlisHSPlasH leaves one spacing empty at each end of a block.
            lower, upper = body.bounds()
            start, end = (lower - radius).tolist(), (upper + radius).tolist()
            blocks.append({"denseMode": 0, "start": start, "end": end})
        elif isinstance(body, Drop):
            mesh = folder / f"body{number}.obj"
            write_drop(mesh, body, radius)
            models.append(
                {
                    "particleFile": str(mesh),
                    "translation": list(body.center),
                    "scale": [1.0, 1.0, 1.0],
                    "mode": 0,
                    "resolutionSDF": [30, 30, 30],
                }
            )
        else:
            particles = folder / f"body{number}.bgeo"
            write_bgeo(particles, body.particles(radius))
            models.append({"particleFile": str(particles), "initialVelocity": list(body.velocity)})
    return {
        "Configuration": {
            "particleRadius": radius,
            "simulationMethod": METHODS[header.solver],
            "gravitation": list(scene.gravity),
            "timeStepSize": job.solver_step,
            "cflMethod": 0,
            "boundaryHandlingMethod": AKINCI_2012,
            "enableZSort": False,
            "numberOfStepsPerRenderUpdate": 1,
            header.solver: job.parameters,
        },
        "Materials": [
            {
                "id": "Fluid",
                "density0": scene.density0,
                "viscosityMethod": 1,
                "Standard viscosity": {"viscosity": scene.viscosity},
            }
        ],
        "RigidBodies": [
            {
                "geometryFile": str(walls),
                "translation": [0, 0, 0],
                "scale": [1, 1, 1],
                "rotationAxis": [1, 0, 0],
                "rotationAngle": 0,
                "isDynamic": False,
                "isWall": True,
                "samplingMode": REGULAR_TRIANGLES,
            }
        ],
        "FluidBlocks": blocks,
        "FluidModels": models,
    }
