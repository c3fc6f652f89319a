"""Job of one solver process: `Job`, and that of a drawn scene."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, Self, final

import h5py
import numpy as np
from numpy.typing import NDArray

from datamodules.generate.bodies import Block, Body, Drop, Vector, describe, from_description
from datamodules.generate.lattice import block_lattice, clear_of
from datamodules.generate.mesh import write_box, write_drop
from datamodules.generate.moving_solids import MovingSolid, describe_solids, solids_from
from datamodules.generate.particle_file import write_bgeo
from datamodules.schema import Header, SceneAttributes

SolverName = Literal["WCSPH", "PCISPH", "PBF", "IISPH", "DFSPH"]

#: SPlisHSPlasH's numbers of its pressure solvers.
METHODS: dict[str, int] = {"WCSPH": 0, "PCISPH": 1, "PBF": 2, "IISPH": 3, "DFSPH": 4}

#: Default parameters of each pressure solver, from the example scenes of SPlisHSPlasH: the
#: tolerance in per cent of the rest density, and the stiffness of WCSPH. With SPlisHSPlasH's
#: default stiffness, a thousandth of it, the fluid falls through the floor.
PARAMETERS: dict[SolverName, dict[str, float]] = {
    "WCSPH": {"stiffness": 50000, "exponent": 7},
    "PCISPH": {"maxIterations": 100, "maxError": 0.05},
    "PBF": {"maxIterations": 100, "maxError": 0.05},
    "IISPH": {"maxIterations": 100, "maxError": 0.05},
    "DFSPH": {"maxIterations": 100, "maxError": 0.05, "maxIterationsV": 100, "maxErrorV": 0.1},
}

#: Parameters that SPlisHSPlasH has for pressure solvers and that have no default here.
FURTHER_PARAMETERS = ("minIterations", "enableDivergenceSolver", "velocityUpdateMethod")

#: Default time step of each pressure solver, s. In a step of WCSPH, which has no pressure
#: solve, sound (19 m/s at its stiffness) may cross 0.4 of a particle.
SOLVER_STEPS = {
    "WCSPH": 0.0005,
    "PCISPH": 0.0025,
    "PBF": 0.0025,
    "IISPH": 0.0025,
    "DFSPH": 0.0025,
}

#: Boundary handling of Akinci et al. 2012, which has boundary particles.
AKINCI_2012 = 0
#: Walls sampled on a regular triangle grid, the paper's "uniform sampling".
REGULAR_TRIANGLES = 1


Points = NDArray[np.floating[Any]]


@dataclass(frozen=True, kw_only=True)
class Job(ABC):
    """Settings of one simulation."""

    output: str  # file to write once the simulation is complete
    header: Header  # attributes of the file, without those that only the solver's process knows
    solver_step: float  # time step of the solver, s
    steps_per_frame: int  # solver steps between two stored frames
    frames: int  # number of stored frames, the start included
    threads: int  # OpenMP threads

    @abstractmethod
    def solver_parameters(self) -> dict[str, Any]:
        """Return the parameters to store, under SPlisHSPlasH's names."""

    @abstractmethod
    def solver_scene(self, folder: Path) -> dict[str, Any]:
        """Return the scene in SPlisHSPlasH's format, and write the files that it needs."""

    @abstractmethod
    def closed_box(self, solids: Sequence[Points]) -> tuple[Points, Points] | None:
        """Return the corners of the box that no particle may leave, m; None if there is none.

        Args:
            solids: Wall particles (M, 3) of each rigid body, m.
        """

    @abstractmethod
    def attributes(self, lower: Points, upper: Points) -> SceneAttributes:
        """Return the scene attributes, given the corners of the closed box or of all particles."""

    @abstractmethod
    def write_notes(self, group: h5py.Group) -> None:
        """Write the attributes that no program reads, such as the seed."""

    @property
    def seed(self) -> list[int]:
        """Seed of the random generator that drew the scene; empty if none did."""
        return []

    @property
    def script(self) -> str | None:
        """Python script to run beside the solver, such as one that moves animated bodies."""
        return None

    @property
    def animated(self) -> list[MovingSolid]:
        """Solids that the solver's process moves; they are the last of its rigid bodies."""
        return []

    @property
    def solids_move(self) -> bool:
        """Return whether the scene has an animated body."""
        return False

    def to_json(self) -> str:
        """Return the job as JSON text."""
        return json.dumps({"kind": type(self).__name__, **asdict(self)})

    @classmethod
    def from_values(cls, values: dict[str, Any]) -> Self:
        """Return the job of the values of `to_json`, without the kind."""
        return cls(**{**values, "header": Header(**values["header"])})


@final
@dataclass(frozen=True, kw_only=True)
class DrawnJob(Job):
    """Simulation of a drawn scene in a closed box."""

    scene: SceneAttributes  # attributes of the simulation
    entropy: list[int]  # seed of the random generator that drew the scene
    bodies: list[Body]  # fluid at the start
    parameters: dict[str, float]  # of the pressure solver, under SPlisHSPlasH's names
    solids: list[MovingSolid] = field(default_factory=list)  # that move

    @property
    def seed(self) -> list[int]:
        return self.entropy

    @property
    def solids_move(self) -> bool:
        return bool(self.solids)

    @property
    def animated(self) -> list[MovingSolid]:
        return self.solids

    def solver_parameters(self) -> dict[str, Any]:
        return {
            **self.parameters,
            "timeStepSize": self.solver_step,
            "boundaryHandlingMethod": AKINCI_2012,
            "samplingMode": REGULAR_TRIANGLES,
        }

    def solver_scene(self, folder: Path) -> dict[str, Any]:
        return scene_file(self, folder)

    def closed_box(self, solids: Sequence[Points]) -> tuple[Points, Points] | None:
        return np.array(self.scene.domain_lower), np.array(self.scene.domain_upper)

    def attributes(self, lower: Points, upper: Points) -> SceneAttributes:
        return self.scene

    def write_notes(self, group: h5py.Group) -> None:
        group.attrs["seed"] = json.dumps(self.seed)
        group.attrs["scene_parameters"] = json.dumps([*map(describe, self.bodies)])
        if self.solids:
            group.attrs["moving_solids"] = json.dumps(describe_solids(self.solids))

    def to_json(self) -> str:
        bodies = [*map(describe, self.bodies)]
        return json.dumps({"kind": type(self).__name__, **asdict(self), "bodies": bodies})

    @classmethod
    def from_values(cls, values: dict[str, Any]) -> Self:
        scene = SceneAttributes(**values["scene"])
        bodies = [*map(from_description, values["bodies"])]
        solids = solids_from(values["solids"])
        return super().from_values({**values, "scene": scene, "bodies": bodies, "solids": solids})


def scene_file(job: DrawnJob, folder: Path) -> dict[str, Any]:
    """Return a drawn scene in SPlisHSPlasH's format, and write the files that it needs."""
    header, scene, radius = job.header, job.scene, job.header.particle_radius
    walls = folder / "walls.obj"
    write_box(walls, scene.domain_lower, scene.domain_upper)
    for number, solid in enumerate(job.solids):
        solid.write(folder / f"solid{number}.obj")
    blocks: list[dict[str, Any]] = []
    models: list[dict[str, Any]] = []
    for number, body in enumerate(job.bodies):
        if isinstance(body, Block) and (job.solids or scene.dimension == 2):
            particles = folder / f"body{number}.bgeo"
            write_bgeo(particles, clear_of(job.solids, block_lattice(body, radius), radius))
            models.append({"particleFile": str(particles)})
        elif isinstance(body, Block):
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
            "sim2D": scene.dimension == 2,
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
            _rigid_body(walls, (0.0, 0.0, 0.0), isWall=True),
            *(
                _rigid_body(folder / f"solid{number}.obj", solid.center, isAnimated=True)
                for number, solid in enumerate(job.solids)
            ),
        ],
        "FluidBlocks": blocks,
        "FluidModels": models,
    }


def _rigid_body(mesh: Path, center: Vector, **kind: bool) -> dict[str, Any]:
    """Return a solid in SPlisHSPlasH's format."""
    return {
        "geometryFile": str(mesh),
        "translation": list(center),
        "scale": [1, 1, 1],
        "rotationAxis": [1, 0, 0],
        "rotationAngle": 0,
        "isDynamic": False,
        "samplingMode": REGULAR_TRIANGLES,
        **kind,
    }
