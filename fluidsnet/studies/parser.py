"""Command-line parser of the studies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn, TypeVar

from jsonargparse import ArgumentParser

from fluidsnet.errors import UserError

T = TypeVar("T")


class Parser(ArgumentParser):
    """Argument parser that raises `UserError` in place of exiting with the usage."""

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Raise a `UserError` with the message and a pointer to ``--help``."""
        raise UserError(f"{message}\nSee `{self.prog} --help`.") from ex


def study_parser(command: str, description: str, options: type) -> Parser:
    """Create the parser of a study's command; ``--config`` files can set options, too."""
    parser = Parser(prog=f"fluidsnet {command}", description=description)
    parser.add_argument("--config", action="config", help="a file with these options")
    parser.add_class_arguments(options)
    return parser


def parse_options(command: str, description: str, options: type[T], arguments: Sequence[str]) -> T:
    """Return the options of a study's command from its command line.

    Raises:
        UserError: An argument cannot be used.
    """
    parser = study_parser(command, description, options)
    parsed = vars(parser.instantiate(parser.parse_args(list(arguments))))
    parsed.pop("config")
    return options(**parsed)
