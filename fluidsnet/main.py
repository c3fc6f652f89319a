"""The front door: LightningCLI for experiments, and words of our own around it."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable
from itertools import count
from pathlib import Path

from fluidsnet.errors import UserError

USAGE = """usage: fluidsnet <command> [options]

Learn a fluid from the particles of an SPH simulation.

data:
  generate   run the SPH solver on random scenes and store them as HDF5
  inspect    say what a data file holds, and what in it looks suspicious

experiments (LightningCLI; compose several --config, base first):
  fit        train a network
  validate   measure a checkpoint on the validation split
  test       measure a checkpoint on the test split, beside the trivial predictors
  predict    roll a checkpoint out on the test simulations and write it for ParaView

studies:
  speed      time a network's step beside the solver, against the number of particles
  ablations  what to predict, and with the global feature or without: over scenes and seeds
  report     write what one run or several logged as one page, with tables and curves

test, validate and predict take a run's folder in place of its files:
  fluidsnet test --run runs/demo

`fluidsnet <command> --help` says more of each.
"""


def main(arguments: list[str] | None = None) -> None:
    """Runs one command; an error that is the user's to mend is one sentence and status 1."""
    # Read when OpenMP is loaded, with torch. Its threads otherwise spin for long while they
    # wait for each other, and beside one other busy process a step takes ten times as long.
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")
    arguments = sys.argv[1:] if arguments is None else arguments
    words: dict[str, Callable[[list[str]], None]] = {
        "generate": _generate,
        "inspect": _inspect,
        "fit": _experiment,
        "validate": _experiment,
        "test": _experiment,
        "predict": _experiment,
        "speed": _speed,
        "ablations": _ablations,
        "report": _report,
    }
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return
    if arguments[0] not in words:
        print(
            f"fluidsnet: there is no command {arguments[0]!r}; "
            f"the commands are {', '.join(words)}.",
            file=sys.stderr,
        )
        sys.exit(2)
    try:
        words[arguments[0]](arguments)
    except UserError as error:
        print(f"fluidsnet: {_words(error)}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("fluidsnet: interrupted.", file=sys.stderr)
        sys.exit(130)


def _words(error: UserError) -> str:
    """What an error says, without what torch adds to one from a process that reads ahead."""
    words = str(error)
    if words.startswith("Caught UserError in "):
        # Then comes that process's traceback, which ends with the error.
        words = words.rpartition(f"{UserError.__module__}.{UserError.__name__}: ")[2].strip()
    return words


def _generate(arguments: list[str]) -> None:
    from datamodules.generate.command import generate_command

    generate_command(arguments[1:])


def _inspect(arguments: list[str]) -> None:
    from datamodules.inspection import inspect_command

    inspect_command(arguments[1:])


def _speed(arguments: list[str]) -> None:
    from fluidsnet.studies.speed.command import speed_command

    speed_command(arguments[1:])


def _ablations(arguments: list[str]) -> None:
    from fluidsnet.studies.ablations.command import ablations_command

    ablations_command(arguments[1:])


def _report(arguments: list[str]) -> None:
    from fluidsnet.report.command import report_command

    report_command(arguments[1:])


def _experiment(arguments: list[str]) -> None:
    # Harmless, and said at each start.
    for message in (
        ".*does not have many workers.*",
        ".*LightningCLI's args parameter is intended.*",
        ".*isinstance.treespec, LeafSpec.*",
        ".*is already saved during checkpointing.*",
        ".*predict returned None.*",
        ".*Grad strides do not match bucket view strides.*",
    ):
        warnings.filterwarnings("ignore", message)
    from lightning.pytorch.utilities.exceptions import SIGTERMException

    from fluidsnet.cli import run

    try:
        run(_with_run(arguments))
    except SIGTERMException:
        # Lightning ends with status 0, as if the work were done.
        print("fluidsnet: terminated.", file=sys.stderr)
        sys.exit(128 + signal.SIGTERM)


def _with_run(arguments: list[str]) -> list[str]:
    """Replaces ``--run FOLDER`` by the configuration and the best checkpoint that lie there.

    Raises:
        UserError: they do not lie there, or the command trains.
    """
    folder, rest = None, []
    words = iter(arguments)
    for word in words:
        if word == "--run":
            folder = next(words, None)
            if folder is None:
                raise UserError("--run needs the folder of a run, such as runs/demo.")
        elif word.startswith("--run="):
            folder = word.removeprefix("--run=")
        else:
            rest.append(word)
    if folder is None:
        return rest
    if rest[0] == "fit":
        raise UserError("--run names a run to test or predict with; fit takes --config.")
    config = Path(folder) / "config.yaml"
    checkpoint = Path(folder) / "checkpoints" / "best.ckpt"
    if not checkpoint.exists():
        # A run that ended before its first validation has no best.
        checkpoint = checkpoint.with_name("last.ckpt")
    for path in (config, checkpoint):
        if not path.exists():
            raise UserError(f"{folder} is not the folder of a run: {path} is missing.")
    _keep_metrics(Path(folder))
    # What the command leaves goes to the run's own folder.
    logger = "--trainer.logger.init_args"
    here = Path(folder).resolve()
    return [
        rest[0],
        f"--config={config}",
        f"--ckpt_path={checkpoint}",
        f"{logger}.save_dir={here.parent}",
        f"{logger}.name={here.name}",
        f"{logger}.version=",
        *rest[1:],
    ]


def _keep_metrics(folder: Path) -> None:
    """Renames the metrics of a CSVLogger, which deletes those that it finds in its folder."""
    metrics = folder / "metrics.csv"
    # Of several processes, those that others have started come later.
    if metrics.exists() and os.environ.get("LOCAL_RANK", "0") == "0":
        others = (folder / f"metrics_{number}.csv" for number in count(1))
        metrics.rename(next(other for other in others if not other.exists()))


if __name__ == "__main__":
    main()
