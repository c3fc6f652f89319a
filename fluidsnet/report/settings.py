"""Section on the configuration: differences between runs and from the shipped settings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from types import NoneType
from typing import Any

import pandas as pd
import yaml
from jsonargparse import ArgumentParser
from lightning import Trainer

import fluidsnet
from fluidsnet.cli import SEED
from fluidsnet.report.document import Folded, Note, Section, Table
from fluidsnet.report.run import CONFIG, Run
from fluidsnet.report.tables import NONE, frame, union

#: Files with the shipped settings, in the repository's folder `configs`.
_SHIPPED = ("trainer.yaml", "model/paper.yaml")
#: Order of the groups of settings.
_ORDER = ("model", "data", "trainer")


@dataclass(frozen=True)
class Setting:
    """A value of a configuration.

    Attributes:
        value: Value as in YAML; the class name of a block.
        default: Default value.
        listed: True for a block in a list, such as a callback.
    """

    value: Any
    default: Any
    listed: bool = False


def settings_section(runs: Sequence[Run]) -> Section:
    """Show the settings that differ between runs, then from the shipped ones, then all."""
    section = Section("Configuration")
    known = {run.name: flat(run.config) for run in runs if run.config is not None}
    if len(known) > 1:
        table = differing(known)
        if table is None:
            section.parts.append(Note("The runs have the same configuration."))
        else:
            caption = "Settings in which the runs differ"
            section.parts.append(Table("settings_that_differ", caption, table))
    base = shipped() if known else {}
    files = " and ".join(f"configs/{name}" for name in _SHIPPED)
    source = files if base else "the defaults of the classes"
    for run in runs:
        if run.config is None:
            text = f"{run.name} has no {CONFIG} that can be read: fluidsnet fit writes it."
            section.parts.append(Note(text, missing=True))
            continue
        table = changed(known[run.name], base)
        if table is None:
            section.parts.append(Note(f"{run.name} is configured as shipped ({source})."))
        else:
            name = "settings" if len(runs) == 1 else f"settings_{run.name}"
            caption = f"Settings of {run.name} that differ from {source}"
            section.parts.append(Table(name, caption, table, folded=len(known) > 1))
        section.parts.append(Folded(f"Full {CONFIG} of {run.name}", run.config_text))
    return section


def flat(config: Mapping[str, Any]) -> dict[str, Setting]:
    """Flatten a configuration to settings with dotted names, such as ``model.target``.

    The arguments of a block follow its name, as on the command line. Arguments that are not set
    get the default of the block's signature.
    """
    trainer = config.get("trainer")
    values = {**config}
    if isinstance(trainer, Mapping):
        values["trainer"] = {**_defaults(Trainer), **trainer}
    return dict(_flat("", values, {"trainer": _defaults(Trainer)}))


def shipped() -> dict[str, Setting]:
    """Return the shipped settings; none where the configs are not installed."""
    folder = Path(fluidsnet.__file__).parents[1] / "configs"
    merged: dict[str, Any] = {"seed_everything": SEED}
    for name in _SHIPPED:
        if not (folder / name).is_file():
            return {}
        for key, value in yaml.safe_load((folder / name).read_text()).items():
            merged[key] = {**merged.get(key, {}), **value}
    return flat(merged)


def changed(run: Mapping[str, Setting], base: Mapping[str, Setting]) -> pd.DataFrame | None:
    """Return a run's settings that differ from a base, or where it has none from the default.

    Returns:
        Name, the run's value and the other; None if nothing differs.
    """
    rows = []
    for name, setting in run.items():
        known = name in base or setting.default is not None
        expected = base[name].value if name in base else setting.default
        if setting.value != expected:
            rows.append((name, _text(setting.value), _text(expected) if known else NONE))
    for name, setting in base.items():
        if setting.listed and name not in run:
            rows.append((name, NONE, _text(setting.value)))
    return _table(("setting", "run", "shipped"), rows)


def differing(runs: Mapping[str, Mapping[str, Setting]]) -> pd.DataFrame | None:
    """Return the settings in which runs differ from each other.

    Args:
        runs: Settings by the name of the run.

    Returns:
        Name and each run's value; None if nothing differs.
    """
    rows = [
        (name, *(_text(it[name].value) if name in it else NONE for it in runs.values()))
        for name in union(runs.values())
    ]
    return _table(("setting", *runs), [row for row in rows if len({*row[1:]}) > 1])


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> pd.DataFrame | None:
    def rank(row: Sequence[str]) -> int:
        group = row[0].partition(".")[0]
        return _ORDER.index(group) if group in _ORDER else len(_ORDER)

    return frame(header, [*sorted(rows, key=rank)]) if rows else None


def _flat(
    name: str, value: Any, default: Any, listed: bool = False
) -> Iterator[tuple[str, Setting]]:
    if _is_block(value):
        yield name, Setting(_short(value["class_path"]), _text(default), listed)
        known = _block_defaults(value["class_path"])
        given = value.get("init_args")
        value, default = {**known, **(given if isinstance(given, Mapping) else {})}, known
    if isinstance(value, list) and value and all(map(_is_block, value)):
        counts = Counter[str]()
        for block in value:
            key = _short(block["class_path"])
            counts[key] += 1
            number = f"#{counts[key]}" if counts[key] > 1 else ""
            yield from _flat(f"{name}.{key}{number}", block, NONE, listed=True)
    elif isinstance(value, Mapping):
        defaults = default if isinstance(default, Mapping) else {}
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}".lstrip("."), inner, defaults.get(key))
    else:
        yield name, Setting(_plain(value), _plain(default), listed)


@lru_cache
def _block_defaults(path: str) -> dict[str, Any]:
    """Return the default arguments of a class; none if it cannot be imported."""
    module, _, name = path.rpartition(".")
    try:
        return _defaults(getattr(import_module(module), name))
    except Exception:  # an import may raise anything; then all given arguments are shown
        return {}


@lru_cache
def _defaults(kind: type) -> dict[str, Any]:
    # jsonargparse also finds the arguments that a class hands on to its parents.
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
    return value if isinstance(value, (int, float, str, NoneType)) else str(value)


def _text(value: Any) -> str:
    """Format a value as YAML in one line."""
    if isinstance(value, str):
        return value or "''"
    if isinstance(value, Mapping) and _is_block(value):
        return _short(value["class_path"])
    text: str = yaml.safe_dump(_plain(value), default_flow_style=True, width=10**6)
    return text.removesuffix("\n").removesuffix("\n...")
