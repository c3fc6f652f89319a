"""Scene files of SPlisHSPlasH: how they are found, and what of them cannot be stored."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, final

from fluidsnet.errors import UserError

#: SPlisHSPlasH's numbers of its pressure solvers, with their names in scene files.
SOLVERS = {
    0: "WCSPH",
    1: "PCISPH",
    2: "PBF",
    3: "IISPH",
    4: "DFSPH",
    5: "Projective Fluids",
    6: "ICSPH",
}

#: Sections with names of files in them, and the keys of those.
FILES = {"RigidBodies": "geometryFile", "FluidModels": "particleFile"}


@final
@dataclass(frozen=True)
class SceneFile:
    """Scene in SPlisHSPlasH's format.

    Attributes:
        path: File that it was read from; the paths in it are relative to its folder.
        content: The JSON values.
    """

    path: Path
    content: dict[str, Any]

    @classmethod
    def find(cls, name: str) -> SceneFile:
        """Read a file, or by its name a scene that SPlisHSPlasH's package has installed.

        Raises:
            UserError: there is no such file, or it is no scene.
        """
        path = Path(name)
        if not path.is_file():
            installed = package_scenes()
            named = [it for it in installed if it.name in (name, f"{name}.json")]
            if not named:
                where = installed[0].parent if installed else "the solver's package, not installed"
                raise UserError(
                    f"{name}: there is no such scene file, and none of that name in {where}; "
                    "give the path of a scene in SPlisHSPlasH's JSON format."
                )
            path = named[0]
        try:
            content = json.loads(path.read_text(encoding="utf-8-sig"))
        except (OSError, ValueError) as error:
            raise UserError(f"{path}: not a scene in JSON: {error}.") from error
        if not isinstance(content, dict) or not isinstance(content.get("Configuration"), dict):
            raise UserError(
                f"{path}: there is no section Configuration in it; a scene in SPlisHSPlasH's JSON "
                "format is needed."
            )
        return cls(path.resolve(), content)

    @property
    def configuration(self) -> dict[str, Any]:
        """Section of the solver's settings."""
        section: dict[str, Any] = self.content["Configuration"]
        return section

    def section(self, name: str) -> list[dict[str, Any]]:
        """Return a section that is a list, empty if it is missing."""
        return list(self.content.get(name, []))

    @property
    def script(self) -> Path | None:
        """Python script that SPlisHSPlasH runs beside the scene."""
        name = self.configuration.get("scriptFile")
        return self.path.parent / name if name else None

    def missing_files(self) -> list[Path]:
        """Return the files of bodies and fluid that the scene names and that are not there."""
        named = [
            self.path.parent / entry.get(key, "")
            for section, key in FILES.items()
            for entry in self.section(section)
        ]
        return [path for path in named if not path.is_file()]

    def refusals(self) -> list[str]:
        """Return what of the scene a data set cannot represent, by name."""
        bodies = self.section("RigidBodies")
        blocks, models = self.section("FluidBlocks"), self.section("FluidModels")
        phases = sorted({str(it.get("id", "Fluid")) for it in (*blocks, *models)})
        elastic = [it for it in self.section("Materials") if it.get("elasticityMethod", 0)]
        # SPlisHSPlasH may save a section that is empty.
        fields = self.section("AnimationFields")
        found = {
            f"{len(self.section('Emitters'))} emitter(s)": self.section("Emitters"),
            f"several phases ({', '.join(phases)})": len(phases) > 1,
            "elastic bodies": elastic,
            "dynamic rigid bodies": [it for it in bodies if it.get("isDynamic")],
            "animation fields": fields,
            "no fluid": not (blocks or models or self.section("Emitters")),
            "an unknown pressure solver": self.method not in SOLVERS,
        }
        return [what for what, present in found.items() if present]

    def unknown_methods(self) -> list[str]:
        """Return sentences on methods of the scene that are not of the data or left out."""
        found = []
        for material in self.section("Materials"):
            if material.get("viscosityMethod", 0) not in (0, 1):
                found.append(
                    "The scene's viscosity is of another method than SPlisHSPlasH's standard one; "
                    "its coefficient is read as one of that."
                )
            found += [
                f"The scene's {name} is left out."
                for name in ("vorticity", "drag")
                if material.get(f"{name}Method", 0)
            ]
        return found

    @property
    def method(self) -> int:
        """Number of the pressure solver; SPlisHSPlasH's default is DFSPH."""
        return int(self.configuration.get("simulationMethod", 4))


def package_scenes() -> list[Path]:
    """Return the scene files of SPlisHSPlasH's package, sorted; empty if it is not installed."""
    try:
        files = metadata.files("pysplishsplash") or []
    except metadata.PackageNotFoundError:
        return []
    paths = (Path(str(it.locate())).resolve() for it in files if "Scenes" in it.parts)
    scenes = [it for it in paths if it.suffix == ".json"]
    # Some installers move the data folder without a note of it.
    return sorted(scenes or Path(sys.prefix).glob("bin/data/Scenes/*.json"))
