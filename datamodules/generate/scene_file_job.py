"""Job of one scene file, and the scene as it is given to the solver."""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import h5py
import numpy as np

from datamodules.generate.job import AKINCI_2012, Job, Points
from datamodules.generate.scene_file import FILES
from datamodules.schema import SceneAttributes

#: Settings of a scene file that would write files, stop the solver or open windows.
_REMOVED = ("pause", "pauseAt", "stopAt", "scriptFile", "stateExportFPS", "dataExportFPS")


@final
@dataclass(frozen=True, kw_only=True)
class SceneFileJob(Job):
    """Simulation of a scene file of SPlisHSPlasH."""

    content: dict[str, Any]  # JSON values of the scene file
    folder: str  # that its file names are relative to
    script_file: str | None  # Python script to run beside the solver

    @property
    def script(self) -> str | None:
        return self.script_file

    @property
    def solids_move(self) -> bool:
        return any(body.get("isAnimated") for body in self.content.get("RigidBodies", []))

    def solver_parameters(self) -> dict[str, Any]:
        own = self.content["Configuration"].get(self.header.solver, {})
        forced = {"timeStepSize": self.solver_step, "boundaryHandlingMethod": AKINCI_2012}
        return {**own, **forced}

    def solver_scene(self, folder: Path) -> dict[str, Any]:
        scene = copy.deepcopy(self.content)
        settings: dict[str, Any] = scene["Configuration"]
        for name in [*settings]:
            if name in _REMOVED or (name.startswith("enable") and name.endswith("Export")):
                del settings[name]
        settings.update(
            # Frames are on time, walls are particles, and rows keep their particle.
            timeStepSize=self.solver_step,
            cflMethod=0,
            boundaryHandlingMethod=AKINCI_2012,
            enableZSort=False,
            numberOfStepsPerRenderUpdate=1,
        )
        for section, name in FILES.items():
            for entry in scene.get(section, []):
                entry[name] = str((Path(self.folder) / entry[name]).resolve())
        return scene

    def closed_box(self, solids: Sequence[Points]) -> tuple[Points, Points] | None:
        bodies = self.content.get("RigidBodies", [])
        walls = [it for it, body in zip(solids, bodies, strict=True) if body.get("isWall")]
        points = np.concatenate(walls) if walls else np.empty((0, 3))
        if not len(points):
            return None
        lower, upper = points.min(axis=0), points.max(axis=0)
        if self._two_dimensional:
            lower[2], upper[2] = lower[2] - 1, upper[2] + 1
        return lower, upper

    def attributes(self, lower: Points, upper: Points) -> SceneAttributes:
        radius = self.header.particle_radius
        # A box with a thickness, also of particles in one plane.
        flat = upper - lower < 2 * radius
        lower, upper = lower - radius * flat, upper + radius * flat
        material: dict[str, Any] = next(iter(self.content.get("Materials", [])), {})
        gravity = self.content["Configuration"].get("gravitation", [0.0, -9.81, 0.0])
        x, y, z = map(float, gravity)
        return SceneAttributes(
            domain_lower=tuple(lower.tolist()),
            domain_upper=tuple(upper.tolist()),
            gravity=(x, y, z),
            density0=float(material.get("density0", 1000.0)),
            viscosity=_coefficient(material, "viscosity"),
            surface_tension=_coefficient(material, "surfaceTension"),
            dimension=2 if self._two_dimensional else 3,
        )

    def write_notes(self, group: h5py.Group) -> None:
        group.attrs["scene_parameters"] = json.dumps(self.content)

    @property
    def _two_dimensional(self) -> bool:
        return bool(self.content["Configuration"].get("sim2D", False))


def _coefficient(material: dict[str, Any], name: str) -> float:
    """Return a coefficient from the settings of a material's methods, 0 if none has it."""
    methods = [material, *(it for it in material.values() if isinstance(it, dict))]
    return next((float(it[name]) for it in methods if name in it), 0.0)
