"""``fluidsnet generate``: the command line of the data generator."""

from __future__ import annotations

import sys
from pathlib import Path

from jsonargparse import ArgumentParser

from datamodules.generate.dataset import generate
from datamodules.generate.recipe import Recipe
from datamodules.schema import SPLITS


def generate_command(arguments: list[str]) -> None:
    """Makes a data set as the options say.

    Raises:
        UserError: as `generate`.
    """
    options = _parser().parse_args(arguments)
    options = _parser().instantiate(options)
    recipe = Recipe(**vars(options.recipe))
    root = Path(options.root)
    failures = generate(recipe, root, options.processes, options.threads)
    made = [root / f"{split}.h5" for split in SPLITS if (root / f"{split}.h5").exists()]
    print(f"{root} holds {', '.join(path.name for path in made)}.")
    if failures:
        names = ", ".join(f"{failure.name} (seed {failure.seed})" for failure in failures)
        print(
            f"{len(failures)} simulation(s) failed and are not in it: {names}; "
            "the same command tries them again once the folder is removed.",
            file=sys.stderr,
        )
    print(f"Next: fluidsnet inspect {made[0]}")


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="fluidsnet generate",
        description=(
            "Runs SPlisHSPlasH on random scenes, a process a simulation, and stores the "
            "frames as HDF5. Calling it again after it was stopped makes only what is missing."
        ),
    )
    parser.add_argument("--config", action="config", help="a file from configs/scene")
    parser.add_argument("--root", type=str, required=True, help="folder of the data set")
    parser.add_argument(
        "--processes", type=int, default=None, help="simulations at once; default: the cores"
    )
    parser.add_argument("--threads", type=int, default=1, help="solver threads in each")
    parser.add_class_arguments(Recipe, "recipe")
    return parser
