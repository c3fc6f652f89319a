"""Command line of FluidsNet: one table of commands."""

from __future__ import annotations

import io
import os
import sys
from importlib import import_module

from fluidsnet.errors import UserError

USAGE = """usage: fluidsnet <command> [options]

Train a neural network on SPH simulations of fluids, measure it, and roll it out.

data:
  generate   simulate random scenes with an SPH solver and store them as HDF5 files
  inspect    describe a data file and report suspicious values; with --model, show what a model
             builds for its scene and what it leaves out

experiments (settings come from YAML files: --config FILE, repeated; later files win):
  fit        train a network
  validate   measure a trained network on the validation data
  test       measure a trained network on the test data and compare it with simple baselines
  predict    simulate with a trained network and write files for ParaView
  export     write a rollout or a simulation as USD, PLY, BGEO or surface meshes

studies and reports:
  speed      compare the time per step of a network and of the SPH solver
  trade      compare errors and cost of networks, priors and a solver that may be careless
  stress     roll a model out in hard cases and say where it is stable, degrades or blows up
  tune       fit the numbers of a prior to data
  ablations  compare prediction targets and the global feature over several scenes and seeds
  report     write an HTML page with the tables and curves of one run or several

installation:
  doctor     print versions, what a step runs on, and what is not installed, for a bug report

examples:
  fluidsnet fit --config configs/trainer.yaml --config configs/model/field.yaml \\
                --config configs/data/sample.yaml
  fluidsnet test --run runs/fluidsnet/version_0

validate, test and predict take the folder of a run (--run) instead of --config and --ckpt_path,
or the name of a model that ships with the package: box_drops, box_drops_40ms, box_drops_80ms,
cuboid_basin_small, dam_break_small, drop_pool_small. `--run box_drops` writes to runs/box_drops.
`fluidsnet <command> --help` lists the options of a command.
"""

# Command to module and function. Modules are imported on demand: some take seconds, and the
# solver must not be loaded for training.
_COMMANDS = {
    "generate": ("datamodules.generate.command", "generate_command"),
    "inspect": ("fluidsnet.studies.plan.command", "inspect_command"),
    "fit": ("fluidsnet.cli", "run"),
    "validate": ("fluidsnet.cli", "run"),
    "test": ("fluidsnet.cli", "run"),
    "predict": ("fluidsnet.cli", "run"),
    "export": ("fluidsnet.studies.export.command", "export_command"),
    "speed": ("fluidsnet.studies.speed.command", "speed_command"),
    "trade": ("fluidsnet.studies.trade.command", "trade_command"),
    "stress": ("fluidsnet.studies.stress.command", "stress_command"),
    "tune": ("fluidsnet.studies.tune.command", "tune_command"),
    "ablations": ("fluidsnet.studies.ablations.command", "ablations_command"),
    "report": ("fluidsnet.report.command", "report_command"),
    "doctor": ("fluidsnet.doctor", "doctor_command"),
}


def main(arguments: list[str] | None = None) -> None:
    """Run one command; print a `UserError` as one sentence and exit with status 1."""
    # OpenMP reads this when torch is loaded. By default its threads spin while they wait; a step
    # then takes ten times as long if one other process uses a core.
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")
    if isinstance(sys.stdout, io.TextIOWrapper):
        # In a log file, keeps the order of tables and of progress lines on stderr.
        sys.stdout.reconfigure(line_buffering=True)
    command, *options = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if command in ("-h", "--help"):
        print(USAGE, end="")
        return
    if command not in _COMMANDS:
        names = ", ".join(_COMMANDS)
        print(f"fluidsnet: unknown command {command!r}; commands: {names}.", file=sys.stderr)
        sys.exit(2)
    module, function = _COMMANDS[command]
    try:
        run = getattr(import_module(module), function)
        run([command, *options] if module == "fluidsnet.cli" else options)
    except UserError as error:
        print(f"fluidsnet: {_message(error)}", file=sys.stderr)
        sys.exit(1)
    except BrokenPipeError:
        # The reader of a pipe has ended, as in `fluidsnet inspect … | head`.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(141)
    except KeyboardInterrupt:
        print("fluidsnet: interrupted.", file=sys.stderr)
        sys.exit(130)


def _message(error: UserError) -> str:
    """Return an error's message without the traceback that a DataLoader worker adds."""
    message = str(error)
    if message.startswith("Caught UserError in "):
        message = message.rpartition(f"{UserError.__module__}.{UserError.__name__}: ")[2].strip()
    return message


if __name__ == "__main__":
    main()
