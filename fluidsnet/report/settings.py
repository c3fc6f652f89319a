"""What a run was configured with, and what of it is not as shipped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml
from jsonargparse import ArgumentParser
from lightning import Trainer

import fluidsnet
from fluidsnet.cli import SEED
from fluidsnet.report.grid import NONE, Grid, union
from fluidsnet.reporting.table import Cell

#: The files that say what is shipped, in the folder `configs` of the repository.
SHIPPED = ("trainer.yaml", "model/paper.yaml")
#: What a reader asks for first comes first.
_ORDER = ("model", "data", "trainer")


@dataclass(frozen=True)
class Setting:
    """One value of a configuration.

    Attributes:
        value: a class's name where it is a block, else as YAML has it.
        default: what it is where nobody sets it.
        listed: whether it is a block in a list, such as a callback.
    """

    value: Any
    default: Any
    listed: bool = False


def flat(config: Mapping[str, Any]) -> dict[str, Setting]:
    """A configuration as one value a name, such as ``model.target``.

    A block's arguments lie under its own name, as the command line takes them too. What the
    configuration leaves out is added from the block's signature.
    """
    trainer = config.get("trainer")
    values = {**config}
    if isinstance(trainer, Mapping):
        values["trainer"] = {**_defaults(Trainer), **trainer}
    return dict(_flat("", values, {"trainer": _defaults(Trainer)}))


def shipped() -> dict[str, Setting]:
    """The settings that the repository ships; none where its configs are not installed."""
    folder = Path(fluidsnet.__file__).parents[1] / "configs"
    merged: dict[str, Any] = {"seed_everything": SEED}
    for name in SHIPPED:
        if not (folder / name).is_file():
            return {}
        merged = _merged(merged, yaml.safe_load((folder / name).read_text()))
    return flat(merged)


def changed(run: Mapping[str, Setting], base: Mapping[str, Setting]) -> Grid | None:
    """What a run sets other than a base does, or, of what that does not know, than the default.

    Returns:
        name, the run's value and the other; None where nothing differs.
    """
    rows = []
    for name, setting in run.items():
        known = name in base or setting.default is not None
        expected = base[name].value if name in base else setting.default
        if setting.value != expected:
            rows.append((name, _words(setting.value), _words(expected) if known else NONE))
    for name, setting in base.items():
        if setting.listed and name not in run:
            rows.append((name, NONE, _words(setting.value)))
    return Grid(("setting", "run", "shipped"), tuple(sorted(rows, key=_rank))) if rows else None


def differing(runs: Mapping[str, Mapping[str, Setting]]) -> Grid | None:
    """The settings in which runs differ from each other.

    Args:
        runs: their settings by their names.

    Returns:
        name, and each one's value; None where nothing differs.
    """
    rows = []
    for name in union(runs.values()):
        values = [
            _words(settings[name].value) if name in settings else NONE for settings in runs.values()
        ]
        if any(value != values[0] for value in values):
            rows.append((name, *values))
    return Grid(("setting", *runs), tuple(sorted(rows, key=_rank))) if rows else None


def _rank(row: Sequence[Cell]) -> int:
    group = str(row[0]).partition(".")[0]
    return _ORDER.index(group) if group in _ORDER else len(_ORDER)


def _flat(
    name: str, value: Any, default: Any, listed: bool = False
) -> Iterator[tuple[str, Setting]]:
    if _is_block(value):
        yield name, Setting(_short(value["class_path"]), _words(default), listed)
        known = _defaults_of(value["class_path"])
        given = value.get("init_args")
        value, default = {**known, **(given if isinstance(given, Mapping) else {})}, known
    if isinstance(value, list) and value and all(map(_is_block, value)):
        value, default = _named(value), {}
        for key, block in value.items():
            yield from _flat(f"{name}.{key}", block, NONE, listed=True)
    elif isinstance(value, Mapping):
        defaults = default if isinstance(default, Mapping) else {}
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}".lstrip("."), inner, defaults.get(key))
    else:
        yield name, Setting(_plain(value), _plain(default), listed)


def _named(blocks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Blocks of a list by their classes' names; of several of a class each has a number."""
    found: dict[str, Any] = {}
    for block in blocks:
        short, number = _short(block["class_path"]), 1
        key = short
        while key in found:
            number += 1
            key = f"{short}#{number}"
        found[key] = block
    return found


def _merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """As the command line composes two files: the later changes what it names."""
    merged = dict(one)
    for key, value in other.items():
        below = merged.get(key)
        both = isinstance(below, Mapping) and isinstance(value, Mapping)
        merged[key] = _merged(below, value) if both else value  # type: ignore[arg-type]
    return merged


@lru_cache
def _defaults_of(path: str) -> dict[str, Any]:
    """Default arguments of a class; none of one that is not there any more."""
    module, _, name = path.rpartition(".")
    try:
        return _defaults(getattr(import_module(module), name))
    except Exception:  # somebody's module may fail as it likes; then all it was told is shown
        return {}


@lru_cache
def _defaults(kind: type) -> dict[str, Any]:
    # Its parser follows the arguments that a class hands on to others.
    parser = ArgumentParser()
    parser.add_class_arguments(kind, fail_untyped=False)
    found: dict[str, Any] = parser.get_defaults().as_dict()
    return found


def _is_block(value: Any) -> bool:
    return isinstance(value, Mapping) and isinstance(value.get("class_path"), str)


def _short(path: str) -> str:
    return path.rpartition(".")[2]


def _plain(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    known = value is None or isinstance(value, (bool, int, float, str))
    return value if known else str(value)


def _words(value: Any) -> str:
    """As YAML has it, in one line."""
    if isinstance(value, str):
        return value or "''"
    if isinstance(value, Mapping) and _is_block(value):
        return _short(value["class_path"])
    text: str = yaml.safe_dump(_plain(value), default_flow_style=True, width=10**6)
    return text.removesuffix("\n").removesuffix("\n...")
