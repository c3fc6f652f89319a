"""Deprecated names in configs and on the command line, and their current names."""

from __future__ import annotations

import re
from typing import Any

#: Deprecated arguments of `FluidsNet`.
KEYS = {"context": "global_feature", "cells": "grid_shape"}
#: Deprecated class names.
CLASSES = {"NoContext": "NoGlobalFeature", "ForeignContext": "GlobalFeaturePermutation"}
#: Deprecated modules.
MODULES = {
    "callbacks.foreign_context": "callbacks.global_feature_permutation",
    "fluidsnet.features.context": "fluidsnet.features.global_feature",
    "fluidsnet.features.field": "fluidsnet.features.voxel_field",
    "fluidsnet.features.messages": "fluidsnet.features.kernel_messages",
}
#: Removed callbacks; their entries are dropped.
REMOVED = {"RolloutTable", "callbacks.RolloutTable", "callbacks.rollout_table.RolloutTable"}

# Keys whose value may be a class name without `class_path:`.
_CLASS_KEYS = {"class_path", "callbacks", "callbacks+", "variant", *KEYS, *KEYS.values()}
_MODEL_OPTION = re.compile(rf"(--model\.(?:init_args\.)?)({'|'.join(KEYS)})(?![^.=])")


class DeprecatedNames:
    """Replace deprecated names and keep a list of them for one warning."""

    def __init__(self) -> None:
        self._found: dict[str, str] = {}

    def warning(self) -> str | None:
        """Return one line that lists the names found, None if there were none."""
        if not self._found:
            return None
        changes = ", ".join(f"{old} → {new}" for old, new in self._found.items())
        return f"fluidsnet: deprecated names, please update your config: {changes}"

    def in_config(self, value: Any, path: tuple[str, ...] = ()) -> Any:
        """Return the values of a config with current names.

        Args:
            value: Mapping, list or plain value, as read from YAML.
            path: Keys that lead to the value.
        """
        if isinstance(value, dict):
            in_model = path[-1:] == ("model",) or path[-2:-1] == ("model",)
            in_model = in_model and path[-1] in ("model", "init_args", "dict_kwargs")
            renamed = {}
            for key, item in value.items():
                name = self._renamed(key, KEYS) if in_model else key
                renamed[name] = self.in_config(item, (*path, str(name)))
            return renamed
        if isinstance(value, list):
            return [self.in_config(item, path) for item in value if not self._is_removed(item)]
        return self._value(value, path[-1]) if path else value

    def in_arguments(self, arguments: list[str]) -> list[str]:
        """Return command-line arguments with current names."""
        renamed: list[str] = []
        option = ""
        for argument in arguments:
            if not argument.startswith("--"):
                # Value of the option before it, if any.
                renamed.append(self._value(argument, _last_key(option)))
                option = ""
                continue
            option, equals, value = argument.partition("=")
            match = _MODEL_OPTION.match(option)
            if match:
                key = self._renamed(match[2], KEYS)
                option = f"{match[1]}{key}{option[match.end() :]}"
            renamed.append(f"{option}{equals}{self._value(value, _last_key(option))}")
        return self._without_removed(renamed)

    def _value(self, value: Any, key: str) -> Any:
        if not isinstance(value, str):
            return value
        if key == "block":
            return self._renamed(value, KEYS)
        if key not in _CLASS_KEYS:
            return value
        module, dot, name = value.rpartition(".")
        current = f"{MODULES.get(module, module)}{dot}{CLASSES.get(name, name)}"
        return self._renamed(value, {value: current}) if current != value else value

    def _renamed(self, name: Any, table: dict[str, str]) -> Any:
        if name not in table:
            return name
        self._found[name] = table[name]
        return table[name]

    def _is_removed(self, item: Any) -> bool:
        name = item.get("class_path") if isinstance(item, dict) else item
        if not isinstance(name, str) or name not in REMOVED:
            return False
        self._found[name] = "removed"
        return True

    def _without_removed(self, arguments: list[str]) -> list[str]:
        kept: list[str] = []
        for argument in arguments:
            option, _, value = argument.partition("=")
            callback = "--trainer.callbacks"
            if option.rstrip("+") == callback and self._is_removed(value):
                continue
            if kept and kept[-1].rstrip("+") == callback and self._is_removed(argument):
                kept.pop()
                continue
            kept.append(argument)
        return kept


def with_current_names(settings: dict[str, Any]) -> dict[str, Any]:
    """Return arguments of `FluidsNet` with current names, without a warning."""
    renamed: dict[str, Any] = DeprecatedNames().in_config(settings, ("model", "init_args"))
    return renamed


def _last_key(option: str) -> str:
    return option.lstrip("-").rpartition(".")[2]
