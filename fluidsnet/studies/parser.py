"""The command line of a study."""

from __future__ import annotations

from typing import NoReturn

from jsonargparse import ArgumentParser

from fluidsnet.errors import UserError


class Parser(ArgumentParser):
    """Says what is wrong in one sentence, and reads options from files, too."""

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Ends the parsing.

        Raises:
            UserError: always.
        """
        raise UserError(f"{message}\nSee `{self.prog} --help`.") from ex


def study_parser(command: str, description: str, options: type) -> Parser:
    """Makes the parser of a command.

    Args:
        command: its name.
        description: what ``--help`` says first.
        options: a dataclass; its attributes are the options.
    """
    parser = Parser(prog=f"fluidsnet {command}", description=description)
    parser.add_argument("--config", action="config", help="a file with these options")
    parser.add_class_arguments(options)
    return parser
