"""YAML text whose aliases and nesting are bounded."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from fluidsnet.errors import UserError

#: Most values that a text may stand for once its aliases are replaced.
MOST_VALUES = 100_000


def read_yaml(text: str) -> Any:
    """Return the plain values of a YAML text.

    Raises:
        yaml.YAMLError: It is no YAML, names objects, or is too large (`check_size`).
    """
    check_size(text)
    return yaml.safe_load(text)


def read_text(path: Path) -> str:
    """Return the text of a config file.

    Raises:
        UserError: It is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise UserError(f"{path} is not UTF-8 text; save it as UTF-8.") from error


def check_size(text: str) -> None:
    """Check that a text does not stand for more values than a computer holds.

    Ten lines of aliases to aliases stand for 10¹⁰ values, over which a program would never end.

    Raises:
        yaml.YAMLError: It is no YAML, or stands for more than `MOST_VALUES`, or is nested too deep.
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        if root is not None and _size(root, {}) > MOST_VALUES:
            raise yaml.YAMLError(
                f"its aliases stand for more than {MOST_VALUES:,} values; write it without them"
            )
    except RecursionError as error:
        raise yaml.YAMLError("it is nested too deep") from error


def _size(node: yaml.Node, known: dict[int, float]) -> float:
    """Return the number of values below a node, aliases replaced; infinite in a loop."""
    if id(node) not in known:
        known[id(node)] = math.inf
        children: list[Any] = []
        if isinstance(node, yaml.MappingNode):
            children = [child for pair in node.value for child in pair]
        elif isinstance(node, yaml.SequenceNode):
            children = node.value
        known[id(node)] = 1 + sum(_size(child, known) for child in children)
    return known[id(node)]
