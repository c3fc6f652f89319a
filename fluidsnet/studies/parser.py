"""Command-line parser of the studies."""

from __future__ import annotations

from typing import NoReturn

from jsonargparse import ArgumentParser

from fluidsnet.errors import UserError


class Parser(ArgumentParser):
    """Argument parser that raises `UserError` in place of exiting with the usage."""

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Raise a `UserError` with the message and a pointer to ``--help``."""
        raise UserError(f"{message}\nSee `{self.prog} --help`.") from ex


def study_parser(command: str, description: str, options: type) -> Parser:
    """Create the parser of a study's command; it reads options from ``--config`` files, too.

    Args:
        command: Name of the command.
        description: First paragraph of ``--help``.
        options: Dataclass whose attributes are the options.
    """
    parser = Parser(prog=f"fluidsnet {command}", description=description)
    parser.add_argument("--config", action="config", help="a file with these options")
    parser.add_class_arguments(options)
    return parser
