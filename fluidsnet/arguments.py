"""Rewriting of the command line of fit, validate, test and predict: ``--run`` and ``base:``."""

from __future__ import annotations

import os
from argparse import ArgumentParser
from itertools import count
from pathlib import Path
from shutil import copyfile
from typing import Any

import yaml

from fluidsnet.errors import UserError
from fluidsnet.models.loading import checkpoint_path, config_path, has_weights
from fluidsnet.models.shipped import is_shipped, run_path, shipped_models
from fluidsnet.plain_yaml import read_text, read_yaml

#: Folder in which shipped models get the folder of a run.
RUNS = Path("runs")


def with_run(arguments: list[str]) -> list[str]:
    """Replace ``--run RUN`` by the config and the best checkpoint in that folder.

    Results are then written to the same folder, and those of a shipped model to ``runs/<name>``.
    A prior alone has no checkpoint.

    Raises:
        UserError: The folder lacks a config or a checkpoint, the command is ``fit``, or the results
            of a shipped model would lie in the folder of another run.
    """
    parser = ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--run", nargs="?", const="")
    parsed, rest = parser.parse_known_args(arguments)
    if parsed.run is None:
        return arguments
    if not parsed.run:
        raise UserError(
            "--run needs the folder of a run, such as runs/demo, or the name of a shipped model: "
            f"{', '.join(shipped_models())}."
        )
    if rest[0] == "fit":
        raise UserError("--run names a run to test or predict with; fit takes --config.")
    source, config = run_path(parsed.run), config_path(parsed.run)
    folder = RUNS / source.name if is_shipped(parsed.run) else source
    weights = [f"--ckpt_path={checkpoint_path(source)}"] if has_weights(config) else []
    if folder != source:
        if (folder / "checkpoints").exists():
            raise UserError(
                f"{folder} is the folder of a run of yours, and the results of the shipped model "
                f"{source.name} would be written there; move it, or name it ./{folder}."
            )
        # Makes it the folder of a run, for the report.
        folder.mkdir(parents=True, exist_ok=True)
        copyfile(config, folder / config.name)
    _keep_metrics(folder)
    logger, resolved = "--trainer.logger.init_args", folder.resolve()
    return [
        rest[0],
        f"--config={config}",
        *weights,
        f"{logger}.save_dir={resolved.parent}",
        f"{logger}.name={resolved.name}",
        f"{logger}.version=",
        *rest[1:],
    ]


def with_base(arguments: list[str]) -> list[str]:
    """Insert the files listed under ``base:`` in the first config in front of it.

    Only the first ``--config`` is read: an overlay that follows other configs is applied to those.
    Paths under ``base:`` are relative to the config's folder.

    Raises:
        UserError: ``base:`` is not a list of existing files.
    """
    for index, argument in enumerate(arguments):
        option, equals, value = argument.partition("=")
        if option not in ("--config", "-c"):
            continue
        if not equals and index + 1 == len(arguments):
            break
        overlay = Path(value if equals else arguments[index + 1])
        base = [f"--config={path}" for path in _base(overlay)]
        return [*arguments[:index], *base, *arguments[index:]]
    return arguments


def _keep_metrics(folder: Path) -> None:
    """Rename metrics.csv, which a CSVLogger would delete."""
    metrics = folder / "metrics.csv"
    # Processes that Lightning starts for DDP run this again.
    if metrics.exists() and os.environ.get("LOCAL_RANK", "0") == "0":
        numbered = (folder / f"metrics_{number}.csv" for number in count(1))
        metrics.rename(next(path for path in numbered if not path.exists()))


def _base(overlay: Path) -> list[Path]:
    try:
        values: Any = read_yaml(read_text(overlay))
    except (OSError, yaml.YAMLError):
        # The parser reads the file again and names the line of the error.
        return []
    names = values.get("base") if isinstance(values, dict) else None
    if names is None:
        return []
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise UserError(f"{overlay}: base is {names!r}; it must be a list of files.")
    paths = [overlay.parent / name for name in names]
    for path in paths:
        if not path.is_file():
            raise UserError(f"{overlay}: its base {path} is missing.")
        read_text(path)
    return paths
