"""Plan of a data set that holds the simulation of one scene file."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import final

from datamodules.generate.job import SOLVER_STEPS, Job
from datamodules.generate.scene_file import SOLVERS, SceneFile
from datamodules.generate.scene_file_job import SceneFileJob
from datamodules.schema import Header
from fluidsnet.errors import UserError

#: SPlisHSPlasH's default of the particle radius, m.
_RADIUS = 0.025
#: Greatest time step of pressure solvers that are not in `SOLVER_STEPS`, s.
_LONGEST_STEP = 0.0025


@final
@dataclass(frozen=True)
class SceneFilePlan:
    """Settings of the simulation of one scene file.

    Attributes:
        scene_file: Path of the file, or name of a scene of SPlisHSPlasH's package.
        duration: Simulated time, s.
        frame_interval: Time between stored frames, s.
        split: File of the data set that holds it.
        run_script: Run the Python script that the scene names.

    Raises:
        UserError: there is no such scene, a value is not possible, or the scene has what a data
            set cannot represent.
    """

    scene_file: str
    duration: float = 3.0
    frame_interval: float = 0.02
    split: str = "test"
    run_script: bool = False

    def __post_init__(self) -> None:
        for name in ("duration", "frame_interval"):
            if not 0 < getattr(self, name) < math.inf:
                raise UserError(f"{name} is {getattr(self, name)}; it must be above zero, in s.")
        if round(self.duration / self.frame_interval) < 1:
            raise UserError(
                f"duration ({self.duration} s) is shorter than frame_interval "
                f"({self.frame_interval} s); there is nothing to simulate."
            )
        scene = SceneFile.find(self.scene_file)
        if found := scene.refusals():
            raise UserError(
                f"{scene.path}: the scene has {', '.join(found)}, which a data set cannot "
                "represent; only scenes of one fluid with static and animated rigid bodies are run."
            )
        if scene.script is not None and not self.run_script:
            raise UserError(
                f"{scene.path}: the scene runs the Python script {scene.script}; read it, and add "
                "--run-script to run it."
            )
        animated = any(body.get("isAnimated") for body in scene.section("RigidBodies"))
        if animated and scene.script is None:
            raise UserError(
                f"{scene.path}: the scene has an animated rigid body and no scriptFile that moves "
                "it; name a Python script in the section Configuration."
            )

    @property
    def frames(self) -> int:
        """Stored frames, the start included."""
        return 1 + round(self.duration / self.frame_interval)

    @property
    def counts(self) -> dict[str, int]:
        """Number of simulations of each split."""
        return {self.split: 1}

    def description(self) -> str:
        """Return the plan and the scene as JSON text, by which the data set is recognized."""
        scene = SceneFile.find(self.scene_file)
        described = {**vars(self), "scene_file": scene.path.name, "scene": scene.content}
        return json.dumps(described, indent=2, sort_keys=True)

    def jobs(self, folder: Path, threads: int) -> dict[str, Job]:
        """Return the job of the simulation by the name of its file in a folder."""
        scene = SceneFile.find(self.scene_file)
        solver = SOLVERS[scene.method]
        radius = float(scene.configuration.get("particleRadius", _RADIUS))
        steps = math.ceil(self.frame_interval / self._longest_step(scene) - 1e-6)
        name = f"{self.split}-00000"
        job = SceneFileJob(
            output=str(folder / f"{name}.h5"),
            header=Header(
                scene=scene.path.stem,
                solver=solver,
                solver_version="",
                solver_parameters={},
                particle_radius=radius,
                support_radius=4 * radius,
                dt=self.frame_interval,
            ),
            solver_step=self.frame_interval / steps,
            steps_per_frame=steps,
            frames=self.frames,
            threads=threads,
            content=scene.content,
            folder=str(scene.path.parent),
            script_file=None if scene.script is None else str(scene.script),
        )
        return {name: job}

    def _longest_step(self, scene: SceneFile) -> float:
        """Return the greatest time step, s.

        That of the scene, or where its step varies (`cflMethod`) the least of its limits and the
        default of the solver.
        """
        settings = scene.configuration
        own = [settings[name] for name in ("timeStepSize",) if name in settings]
        if not settings.get("cflMethod", 1) and own:
            return float(own[0])
        default = {**SOLVER_STEPS}.get(SOLVERS[scene.method], _LONGEST_STEP)
        return float(min([*own, settings.get("cflMaxTimeStepSize", default), default]))
