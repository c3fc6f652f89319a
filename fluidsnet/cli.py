"""LightningCLI for fit, validate, test and predict."""

from __future__ import annotations

import os
import re
import signal
import sys
from argparse import SUPPRESS
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from jsonargparse import get_loader, set_loader
from lightning import Trainer
from lightning.fabric.plugins import CheckpointIO
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Callback, ProgressBar
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI, SaveConfigCallback
from lightning.pytorch.core import LightningModule
from lightning.pytorch.utilities.exceptions import SIGTERMException
from yaml import YAMLError

# Imported so that configs can name their classes without the package.
import callbacks as callbacks
from callbacks.console_progress import ConsoleProgress
from callbacks.one_step_table import OneStepTable
from callbacks.run_summary import RunSummary
from datamodules.sph import SPHDataModule
from fluidsnet.arguments import with_base, with_run
from fluidsnet.checkpoint_io import WholeCheckpoints
from fluidsnet.console import quiet
from fluidsnet.deprecated import DeprecatedNames
from fluidsnet.errors import UserError
from fluidsnet.module import NEEDS, FluidsNet

#: Default global seed.
SEED = 0
#: Precisions of the trainer that positions allow.
PRECISIONS = (None, "32-true", "32", 32, "bf16-mixed", "bf16", "16-mixed", "16", 16)
#: Folder for the files of a run without a logger.
UNLOGGED = "runs/unlogged"
# Errors of Lightning and of the parser that an option mends.
_MENDABLE = re.compile("val_check_interval|class_path")
# Name of the parser's YAML loader that replaces deprecated names.
_LOADER = "fluidsnet"


class Parser(LightningArgumentParser):
    """Parser that raises `UserError` instead of printing its usage."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{"parser_mode": _LOADER, **kwargs})

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Raise the `UserError` that caused a parsing error, or one with the parser's message.

        Raises:
            UserError: Always.
        """
        # Parsers of a class's arguments are named after the running script.
        prog = self.prog if self.prog.startswith("fluidsnet") else "fluidsnet"
        raise _cause(ex) or UserError(f"{message}\nSee `{prog} --help`.") from ex


class SaveFitConfig(SaveConfigCallback):
    """Save the config of a training run; a later test does not overwrite it."""

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        if stage == "fit":
            super().setup(trainer, pl_module, stage)


class FluidsNetCLI(LightningCLI):
    """LightningCLI that links the data's needs to the model and adds the console's callbacks."""

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        # Read by `with_base`; the parser has to accept the key.
        parser.add_argument("--base", type=list[str] | None, default=None, help=SUPPRESS)
        for need in NEEDS:
            parser.link_arguments(f"data.{need}", f"model.init_args.{need}", apply_on="instantiate")

    def _parse_ckpt_path(self) -> None:
        """Leave the configuration as given; the module checks that the checkpoint matches it.

        Lightning would replace ``--model`` options by the checkpoint's hyperparameters.
        """

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:
        """Instantiate the trainer with `RunSummary` and `ConsoleProgress`."""
        config = self._get(self.config_init, "trainer")
        chosen: Any = config.callbacks or []
        chosen = list(chosen) if isinstance(chosen, list) else [chosen]
        if config.precision not in PRECISIONS:
            raise UserError(
                f"trainer.precision is {config.precision}; use 32-true, bf16-mixed or 16-mixed: "
                "positions need 32 bits."
            )
        plugins: Any = config.plugins or []
        plugins = [*plugins] if isinstance(plugins, list) else [plugins]
        if not any(isinstance(plugin, CheckpointIO) for plugin in plugins):
            plugins.append(WholeCheckpoints())
        own: list[Callback] = [RunSummary()]
        if config.enable_progress_bar is not False and not any(
            isinstance(callback, ProgressBar) for callback in chosen
        ):
            own.append(ConsoleProgress())
        return super().instantiate_trainer(
            callbacks=[*own, *chosen],
            plugins=plugins,
            enable_model_summary=config.enable_model_summary or False,
            default_root_dir=config.default_root_dir or UNLOGGED,
            **kwargs,
        )

    def _prepare_subcommand_kwargs(self, subcommand: str) -> dict[str, Any]:
        options = super()._prepare_subcommand_kwargs(subcommand)
        word = options.get("ckpt_path")
        if str(word).startswith(("hpc", "registry")):
            raise UserError(f"--ckpt_path {word}: name the file of a checkpoint, or last or best.")
        if word in ("last", "best"):
            options["ckpt_path"] = self._own_checkpoint(str(word))
        return options

    def _own_checkpoint(self, word: str) -> str:
        """Return the last or best checkpoint in the folder of this run.

        Lightning would train from scratch where there is none.

        Raises:
            UserError: There is none.
        """
        folder = self.trainer.log_dir or self.trainer.default_root_dir
        path = Path(folder) / "checkpoints" / f"{word}.ckpt"
        if not path.is_file():
            raise UserError(
                f"--ckpt_path {word}: {path} is missing; name the file itself, or set "
                "trainer.logger.init_args.version to that of the run to continue."
            )
        return str(path)

    def validate(self, **options: Any) -> None:
        """Validate and print the metrics, one a line."""
        self._print(self.trainer.validate(**{**options, "verbose": False}))

    def test(self, **options: Any) -> None:
        """Test; print the metrics if no `OneStepTable` has printed them."""
        chosen: list[Callback] = self.trainer.callbacks  # type: ignore[attr-defined]
        metrics = self.trainer.test(**{**options, "verbose": False})
        if not any(isinstance(callback, OneStepTable) for callback in chosen):
            self._print(metrics)

    def _print(self, metrics: Sequence[Mapping[str, float]]) -> None:
        if self.trainer.is_global_zero:
            for name, value in metrics[0].items():
                print(f"{name:<40}{value:.4g}")


def run(arguments: list[str]) -> None:
    """Run fit, validate, test or predict.

    Args:
        arguments: Command and its options.

    Raises:
        UserError: The options, the data or the combination of blocks cannot be used.
    """
    quiet()
    try:
        _run(arguments)
    except SIGTERMException:
        # Lightning would exit with status 0.
        print("fluidsnet: terminated.", file=sys.stderr)
        sys.exit(128 + signal.SIGTERM)
    except SystemExit as ended:
        # Lightning turns Ctrl-C into status 1.
        if isinstance(ended.__context__, KeyboardInterrupt):
            raise ended.__context__ from None
        raise
    except MisconfigurationException as error:
        raise UserError(str(error)) from error
    except RuntimeError as error:
        if "more than one stateful callback" not in str(error):
            raise
        # The first sentence names the callback.
        raise UserError(f"{str(error).partition('. ')[0]}: give each a name of its own.") from error
    except ValueError as error:
        # The parser wraps the error of a block that refuses its arguments.
        cause = _cause(error) or _missing_package(error)
        if cause is None and not _MENDABLE.search(str(error)):
            raise
        raise cause or UserError(" ".join(str(error).split())) from error


def _run(arguments: list[str]) -> None:
    names = DeprecatedNames()
    load = get_loader("yaml")
    set_loader(_LOADER, lambda text: names.in_config(load(text)), exceptions=(YAMLError,))

    class CLI(FluidsNetCLI):
        def before_instantiate_classes(self) -> None:
            # All configs have been read; processes that Lightning starts for DDP stay silent.
            warning = names.warning()
            if warning and os.environ.get("LOCAL_RANK", "0") == "0":
                print(warning, file=sys.stderr)

    CLI(
        FluidsNet,
        SPHDataModule,
        parser_class=Parser,
        parser_kwargs={"prog": "fluidsnet"},
        subclass_mode_model=True,
        subclass_mode_data=True,
        save_config_callback=SaveFitConfig,
        save_config_kwargs={"overwrite": True},
        seed_everything_default=SEED,
        auto_configure_optimizers=False,
        args=[*names.in_arguments(with_base(with_run(arguments))), "--base=null"],
    )


def _missing_package(error: BaseException | None) -> UserError | None:
    """Return an error that names the package that a class of the config needs, if one does."""
    while error is not None and not isinstance(error, ModuleNotFoundError):
        error = error.__cause__ or error.__context__
    return None if error is None else UserError(" ".join(str(error).split()))


def _cause(error: BaseException | None) -> UserError | None:
    """Return the `UserError` in the chain of causes of an error, if any."""
    while error is not None and not isinstance(error, UserError):
        error = error.__cause__ or error.__context__
    return error
