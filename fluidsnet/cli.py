"""LightningCLI with what FluidsNet's configs need."""

from __future__ import annotations

from argparse import SUPPRESS
from typing import NoReturn

from lightning import Trainer
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI, SaveConfigCallback
from lightning.pytorch.core import LightningModule

# Imported so that configs can name their classes without the package.
import callbacks as callbacks
from datamodules.sph import SPHDataModule
from fluidsnet.config_base import with_base
from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet

#: Of everything that is drawn, where nobody sets another.
SEED = 0


class Parser(LightningArgumentParser):
    """Says what is wrong without the page of usage that would hide it."""

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Ends the parsing.

        Raises:
            UserError: always; where the cause was one itself, in its words.
        """
        raise _ours(ex) or UserError(f"{message}\nSee `{self.prog} --help`.") from ex


class SaveFitConfig(SaveConfigCallback):
    """Keeps the configuration of a training run; testing it later does not replace it."""

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        if stage == "fit":
            super().setup(trainer, pl_module, stage)


class FluidsNetCLI(LightningCLI):
    """The scene reaches the model from the data, so that nobody types it twice."""

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        # Read by `with_base`; the parser only has to know that configs may have it.
        parser.add_argument("--base", type=list[str] | None, default=None, help=SUPPRESS)
        shape = "grid_shape"
        parser.link_arguments(f"data.{shape}", f"model.init_args.{shape}", apply_on="instantiate")

    def _parse_ckpt_path(self) -> None:
        """Leave the configuration as given; the module checks that the checkpoint matches it.

        Lightning would replace ``--model`` options by the checkpoint's hyperparameters.
        """


def _ours(error: BaseException | None) -> UserError | None:
    """The error of ours that another one was made of, if any."""
    while error is not None and not isinstance(error, UserError):
        error = error.__cause__ or error.__context__
    return error


def run(arguments: list[str]) -> None:
    """Runs fit, validate, test or predict.

    Args:
        arguments: the command and its options.

    Raises:
        UserError: the options, the data or the combination of blocks cannot be used.
    """
    try:
        _run(arguments)
    except MisconfigurationException as error:
        raise UserError(str(error)) from error
    except RuntimeError as error:
        if "more than one stateful callback" not in str(error):
            raise
        # Which one, is in the first sentence.
        raise UserError(f"{str(error).partition('. ')[0]}: give each a name of its own.") from error
    except ValueError as error:
        # A block that refuses its arguments does so inside the parser, which wraps it.
        ours = _ours(error)
        if ours is None:
            raise
        raise ours from error


def _run(arguments: list[str]) -> None:
    FluidsNetCLI(
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
        args=[*with_base(arguments), "--base=null"],
    )
