"""``fluidsnet generate``: command line of the data generator."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from jsonargparse import ArgumentParser

from datamodules.generate.dataset import Plan, generate
from datamodules.generate.job import AKINCI_2012
from datamodules.generate.recipe import Recipe
from datamodules.generate.scene_file import SceneFile
from datamodules.generate.scene_file_plan import SceneFilePlan
from datamodules.schema import SPLITS


def generate_command(arguments: list[str]) -> None:
    """Generate a data set with the options given.

    Raises:
        UserError: as `generate`.
    """
    plan: Plan
    if any(argument.partition("=")[0] == "--scene-file" for argument in arguments):
        parser = _scene_file_parser()
        options = parser.instantiate(parser.parse_args(arguments))
        processes, threads = 1, options.threads or os.cpu_count() or 1
        plan = SceneFilePlan(
            **{name: getattr(options, name) for name in SceneFilePlan.__dataclass_fields__}
        )
        _print_changes(plan)
    else:
        parser = _parser()
        options = parser.instantiate(parser.parse_args(arguments))
        processes, threads = options.processes, options.threads
        plan = Recipe(**vars(options.recipe))
    root = Path(os.path.expandvars(options.root)).expanduser()
    failures = generate(plan, root, processes, threads)
    files = [root / f"{split}.h5" for split in SPLITS if (root / f"{split}.h5").exists()]
    print(f"{root} holds {', '.join(path.name for path in files)}.")
    if failures:
        names = ", ".join(f"{failure.name} (seed {failure.seed})" for failure in failures)
        print(
            f"{len(failures)} simulation(s) failed and are not in the data set: {names}. To run "
            "them again, remove the folder and repeat the command.",
            file=sys.stderr,
        )
    print(f"Next: fluidsnet inspect {files[0]}")


def _print_changes(plan: SceneFilePlan) -> None:
    """Print what of the scene file the simulation does not keep."""
    (job,) = plan.jobs(Path(), threads=1).values()
    scene = SceneFile.find(plan.scene_file)
    changes = [f"a fixed time step of {1e3 * job.solver_step:g} ms"]
    if scene.configuration.get("boundaryHandlingMethod", 2) != AKINCI_2012:
        changes.append("walls of particles (Akinci et al. 2012)")
    print(f"{scene.path}: run by {job.header.solver} with {' and '.join(changes)}")


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="fluidsnet generate",
        description=(
            "Run SPlisHSPlasH on random scenes, one process for each simulation, and store the "
            "frames as HDF5. Run it again after an interruption: only missing simulations are run. "
            "A scene file of SPlisHSPlasH is run by `fluidsnet generate --scene-file FILE --root "
            "FOLDER`; its options: `fluidsnet generate --scene-file FILE --help`."
        ),
    )
    parser.add_argument("--config", action="config", help="config file, such as in configs/scene")
    parser.add_argument("--root", type=str, required=True, help="folder of the data set")
    parser.add_argument(
        "--processes", type=int, help="simulations at the same time; by default one a core"
    )
    parser.add_argument("--threads", type=int, default=1, help="solver threads per simulation")
    parser.add_class_arguments(Recipe, "recipe")
    return parser


def _scene_file_parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="fluidsnet generate",
        description=(
            "Run SPlisHSPlasH on a scene file in its JSON format and store the frames as HDF5. "
            "DoubleDamBreak.json and other scenes of its package are found by their names."
        ),
    )
    parser.add_argument(
        "--scene-file",
        type=str,
        required=True,
        metavar="FILE",
        help="path of the file, or name of a scene of SPlisHSPlasH's package",
    )
    parser.add_argument("--root", type=str, required=True, help="folder of the data set")
    parser.add_argument("--duration", type=float, default=3.0, help="simulated time, s")
    parser.add_argument(
        "--frame-interval", type=float, default=0.02, help="time between stored frames, s"
    )
    parser.add_argument("--split", choices=SPLITS, default="test", help="file of the data set")
    parser.add_argument(
        "--run-script", action="store_true", help="run the Python script that the scene names"
    )
    parser.add_argument("--threads", type=int, help="solver threads; by default all cores")
    return parser
