"""A job in SPlisHSPlasH's own scene format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from datamodules.generate.job import Job, SolverName
from datamodules.generate.mesh import write_box, write_drop
from datamodules.generate.scenes import Block

#: SPlisHSPlasH's numbers for its pressure solvers.
_METHODS: dict[SolverName, int] = {"WCSPH": 0, "PCISPH": 1, "IISPH": 3, "DFSPH": 4}

#: What each pressure solver is told unless a recipe says otherwise: the tolerance, in per
#: cent of the rest density, of the solver's own example scenes, and for WCSPH their stiffness;
#: the solver's own default is a thousandth of it, and the fluid falls through the floor.
PARAMETERS: dict[SolverName, dict[str, float]] = {
    "WCSPH": {"stiffness": 50000, "exponent": 7},
    "PCISPH": {"maxIterations": 100, "maxError": 0.05},
    "IISPH": {"maxIterations": 100, "maxError": 0.05},
    "DFSPH": {"maxIterations": 100, "maxError": 0.05, "maxIterationsV": 100, "maxErrorV": 0.1},
}

#: The fixed time step of each pressure solver unless a recipe says otherwise, s. WCSPH has no
#: solve that makes up for a long step: sound, at 19 m/s with its stiffness, may cross 0.4 of
#: a particle in one.
SOLVER_STEPS: dict[SolverName, float] = {
    "WCSPH": 0.0005,
    "PCISPH": 0.0025,
    "IISPH": 0.0025,
    "DFSPH": 0.0025,
}

#: Boundary handling after Akinci et al. 2012, the one with boundary particles.
AKINCI_2012 = 0
#: Walls sampled on a regular triangle grid, which is the paper's "uniform sampling".
REGULAR_TRIANGLES = 1


def scene_file(job: Job, folder: Path) -> dict[str, Any]:
    """The solver's own description of a job, with the meshes it names written to a folder."""
    radius = job.particle_radius
    walls = folder / "walls.obj"
    write_box(walls, job.domain)
    blocks, models = [], []
    for number, body in enumerate(job.bodies):
        if isinstance(body, Block):
            # The solver leaves one spacing free at each end of a block.
            lower, upper = body.bounds()
            blocks.append(
                {
                    "denseMode": 0,
                    "start": (lower - radius).tolist(),
                    "end": (upper + radius).tolist(),
                }
            )
        else:
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
    return {
        "Configuration": {
            "particleRadius": radius,
            "simulationMethod": _METHODS[job.solver],
            "gravitation": list(job.gravity),
            "timeStepSize": job.solver_step,
            "cflMethod": 0,
            "boundaryHandlingMethod": AKINCI_2012,
            "enableZSort": False,
            "numberOfStepsPerRenderUpdate": 1,
            job.solver: job.parameters,
        },
        "Materials": [
            {
                "id": "Fluid",
                "density0": job.density0,
                "viscosityMethod": 1,
                "Standard viscosity": {"viscosity": job.viscosity},
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
