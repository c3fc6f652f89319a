"""``fluidsnet generate``: command line of the data generator."""

from __future__ import annotations

import sys
from pathlib import Path

from jsonargparse import ArgumentParser

from datamodules.generate.dataset import generate
from datamodules.generate.recipe import Recipe
from datamodules.schema import SPLITS


def generate_command(arguments: list[str]) -> None:
    """Generate a data set with the options given.

    Raises:
        UserError: as `generate`.
    """
    parser = _parser()
    options = parser.instantiate(parser.parse_args(arguments))
    root = Path(options.root)
    failures = generate(Recipe(**vars(options.recipe)), root, options.processes, options.threads)
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


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="fluidsnet generate",
        description=(
            "Run SPlisHSPlasH on random scenes, one process for each simulation, and store the "
            "frames as HDF5. Run it again after an interruption: only missing simulations are run."
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
