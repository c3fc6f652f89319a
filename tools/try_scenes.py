"""Run every scene of SPlisHSPlasH's package for a moment and write docs/scene_files.md.

    python -m tools.try_scenes

Takes a minute on two cores. A scene that takes longer than a minute is stopped.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py

from datamodules.generate.scene_file import package_scenes
from datamodules.generate.solver import solver_version
from datamodules.reader import FrameReader
from fluidsnet.errors import UserError
from fluidsnet.progress import Progress
from fluidsnet.reporting.table import markdown

_OUTPUT = Path(__file__).parents[1] / "docs" / "scene_files.md"
_COLUMNS = ("scene", "solver", "fluid", "solid", "what happens")
_DURATION, _LIMIT = 0.1, 60.0
_TEXT = """# Scene files of SPlisHSPlasH

`fluidsnet generate --scene-file NAME --root FOLDER` runs these scenes, which SPlisHSPlasH's
package installs (version {version}), or refuses them with the reason. Each was run for {duration} s
of simulated time, on one thread; `python -m tools.try_scenes` makes the table. [data.md](data.md)
says what of a scene is kept.

{count} scenes: {runs} run, {refused} are refused, {failed} fail.

{table}
"""


def try_scene(path: Path) -> tuple[str, ...]:
    """Return the row of a scene: name, solver, numbers of particles, and what happened."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            *(sys.executable, "-m", "fluidsnet.main", "generate", "--run-script", "--threads", "1"),
            *("--scene-file", str(path), "--root", folder, "--duration", str(_DURATION)),
        ]
        name = path.name
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=_LIMIT, check=False
            )
        except subprocess.TimeoutExpired:
            return name, "", "", "", f"runs; {_DURATION} s take more than {_LIMIT:.0f} s"
        data = Path(folder) / "test.h5"
        if done.returncode == 0 and data.exists():
            with h5py.File(data) as file:
                group = file["00000"]
                solver, fluid = str(file.attrs["solver"]), group["position"].shape[1]
                solid = group["solid_position"].shape[-2]
            return name, solver, f"{fluid:,}", f"{solid:,}", f"runs{_not_trainable(data)}"
    reason = (done.stderr.strip().splitlines() or [""])[-1]
    if "the scene has " in reason:
        found = reason.partition("the scene has ")[2].partition(", which a data set")[0]
        return name, "", "", "", f"refused: {found}"
    return name, "", "", "", f"fails: {reason.rpartition(': ')[2]}"


def _not_trainable(data: Path) -> str:
    """Return why a network cannot be trained on the data yet, empty if it can."""
    try:
        reader = FrameReader(data)
        reader.state(next(iter(reader.frames)), 0, stride=1)
    except UserError as error:
        reason = str(error).rpartition(": ")[2].replace("/00000", "the simulation")
        return f"; stored, not for training: {reason.removesuffix('.')}"
    return ""


def main() -> None:
    """Try all scenes, two at a time, and write the page."""
    scenes = package_scenes()
    if not scenes:
        sys.exit("The solver's package is not installed: pip install 'fluidsnet[solver]'.")
    with ThreadPoolExecutor(2) as pool:
        rows = [*Progress(pool.map(try_scene, scenes), total=len(scenes), unit="scene")]
    runs = sum(row[-1].startswith("runs") for row in rows)
    refused = sum(row[-1].startswith("refused") for row in rows)
    text = _TEXT.format(
        version=solver_version(),
        duration=_DURATION,
        count=len(rows),
        runs=runs,
        refused=refused,
        failed=len(rows) - runs - refused,
        table=markdown(_COLUMNS, rows),
    )
    _OUTPUT.write_text(text)
    print(f"{_OUTPUT.relative_to(Path.cwd())}: {runs} of {len(rows)} scenes run")


if __name__ == "__main__":
    main()
