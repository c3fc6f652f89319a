"""Command line of FluidsNet: one table of commands."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from jsonargparse import get_loader, set_loader
from yaml import YAMLError

from fluidsnet.disk_space import not_written
from fluidsnet.errors import NotWritten, UserError
from fluidsnet.plain_yaml import check_size, read_text
from fluidsnet.printable import printable

USAGE = """usage: fluidsnet <command> [options]

Train a neural network on SPH simulations of fluids, measure it, and roll it out.

data:
  generate   simulate random scenes with an SPH solver and store them as HDF5 files
  convert    read data of LagrangeBench, DeepLagrangianFluids, or VTK, PLY and BGEO files
  inspect    describe a data file and report suspicious values; with --model, show what a model
             builds for its scene and what it leaves out

experiments (settings come from YAML files: --config FILE, repeated; later files win):
  fit        train a network
  validate   measure a trained network on the validation data
  test       measure a trained network on the test data and compare it with simple baselines
  predict    simulate with a trained network and write files for ParaView

simulation:
  simulate   simulate a scene with a trained model in place of the solver; no truth is needed
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
  fluidsnet simulate DoubleDamBreak.json --model box_drops --seconds 4

validate, test and predict take the folder of a run (--run) instead of --config and --ckpt_path,
or the name of a model that ships with the package: box_drops, box_drops_40ms, box_drops_80ms,
cuboid_basin_small, dam_break_small, drop_pool_small. `--run box_drops` writes to runs/box_drops.
`fluidsnet <command> --help` lists the options of a command.
"""

# Command to module and function. Modules are imported on demand: some take seconds, and the
# solver must not be loaded for training.
_COMMANDS = {
    "generate": ("datamodules.generate.command", "generate_command"),
    "convert": ("datamodules.convert.command", "convert_command"),
    "inspect": ("fluidsnet.studies.plan.command", "inspect_command"),
    "fit": ("fluidsnet.cli", "run"),
    "validate": ("fluidsnet.cli", "run"),
    "test": ("fluidsnet.cli", "run"),
    "predict": ("fluidsnet.cli", "run"),
    "export": ("fluidsnet.studies.export.command", "export_command"),
    "simulate": ("fluidsnet.studies.simulate.command", "simulate_command"),
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
    if arguments is None:
        _start_process()
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
        _bound_yaml()
        options = list(map(_expanded, options))
        _check_configs(options)
        run = getattr(import_module(module), function)
        run([command, *options] if module == "fluidsnet.cli" else options)
    except NotWritten as error:
        _fail_at_hdf5(error, arguments is None)
    except UserError as error:
        _fail(_message(error))
    except BrokenPipeError:
        # The reader of a pipe has ended, as in `fluidsnet inspect … | head`.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(141)
    except OSError as error:
        if error.errno is None:
            raise
        # A full disk, a folder that may not be written, a name that is too long.
        _fail(f"{error.filename or command}: {os.strerror(error.errno)}.")
    except (MemoryError, RuntimeError) as error:
        if failure := not_written(error):
            _fail_at_hdf5(failure, arguments is None)
        if not _lacks_memory(error):
            raise
        reason = " ".join(str(error).split()[:40])
        _fail(f"not enough memory ({reason}); lower data.batch_size or raise data.voxel_size.")
    except KeyboardInterrupt:
        _interrupted()
    except SystemError as error:
        # What Python makes of Ctrl-C that comes while numba calls a kernel.
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        _interrupted()


def _start_process() -> None:
    """Set up the streams of a process, and the import path of its children."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # In a log file, keeps the order of tables and of progress lines on stderr. A terminal
            # that knows ASCII alone gets other characters as escapes.
            stream.reconfigure(line_buffering=True, errors="backslashreplace")
    threading.excepthook = _in_thread
    sys.unraisablehook = _in_callback
    if sys.modules["__main__"].__spec__ is None:
        # Python would look for modules of its children in the working folder first, where data of
        # strangers may lie; with `python -m` the user has chosen that.
        os.environ["PYTHONSAFEPATH"] = "1"


def _lacks_memory(error: Exception) -> bool:
    """Return whether an error of Python or of torch says that memory is full."""
    return (
        isinstance(error, MemoryError)
        or type(error).__name__ == "OutOfMemoryError"
        or "can't allocate memory" in str(error)
    )


def _bound_yaml() -> None:
    """Bound the size of what configs stand for."""
    load = get_loader("yaml")
    if load.__name__ == "bounded":
        return

    def bounded(text: str) -> Any:
        check_size(text)
        return load(text)

    set_loader("yaml", bounded, exceptions=(YAMLError,))


def _check_configs(options: list[str]) -> None:
    """Check that config files are text, since the parsers do not name one that is not."""
    for index, option in enumerate(options):
        name, _, value = option.partition("=")
        if name in ("--config", "-c"):
            path = Path(value or "".join(options[index + 1 : index + 2]))
            if path.is_file():
                read_text(path)


def _expanded(argument: str) -> str:
    """Return an argument with ``~`` or a variable at the start of its value replaced.

    A shell replaces neither ``~`` behind an equals sign nor anything in quotation marks.
    """
    option, equals, value = argument.rpartition("=") if argument[:2] == "--" else ("", "", argument)
    if value[:1] not in ("~", "$"):
        return argument
    return f"{option}{equals}{os.path.expandvars(os.path.expanduser(value))}"


def _in_thread(failed: threading.ExceptHookArgs) -> None:
    """Print the traceback of a thread, but of a full disk, which the main thread names."""
    if not issubclass(failed.exc_type, OSError):
        threading.__excepthook__(failed)


def _in_callback(ignored: sys.UnraisableHookArgs) -> None:
    """Raise Ctrl-C again, which Python drops where it comes in a callback of the garbage collector.

    HDF5 handles are counted by such callbacks, so that a loop that writes a file is often in one.
    Of a full disk nothing is printed: the main thread names it.
    """
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        # Raised at once, it would be dropped in this function, too.
        main_thread = threading.main_thread().ident
        again = threading.Timer(0.01, signal.pthread_kill, (main_thread, signal.SIGINT))
        again.daemon = True
        again.start()
        return
    failure = not_written(ignored.exc_value)
    if failure is None or not failure.full:
        sys.__unraisablehook__(ignored)


def _interrupted() -> NoReturn:
    """Say so, and exit with the status of SIGINT."""
    print("fluidsnet: interrupted.", file=sys.stderr)
    sys.exit(130)


def _fail(message: str) -> NoReturn:
    """Print a message to stderr and exit with status 1."""
    print(f"fluidsnet: {printable(message)}", file=sys.stderr)
    sys.exit(1)


def _fail_at_hdf5(error: NotWritten, whole_process: bool) -> NoReturn:
    """Fail as `_fail` does, and end before HDF5 writes again what it could not, and crashes."""
    if not whole_process:
        _fail(str(error))
    try:
        print(f"fluidsnet: {printable(str(error))}", file=sys.stderr)
        sys.stderr.flush()
        sys.stdout.flush()
    finally:
        # The streams may go to the same full disk.
        os._exit(1)


def _message(error: UserError) -> str:
    """Return an error's message without the traceback that a DataLoader worker adds."""
    message = str(error)
    if message.startswith("Caught UserError in "):
        message = message.rpartition(f"{UserError.__module__}.{UserError.__name__}: ")[2].strip()
    return message


if __name__ == "__main__":
    main()
