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
_MODEL_PATHS = (("model", "init_args"), ("model", "dict_kwargs"))
# Patterns of command-line arguments, each preceded by a null character: `--name=value` and
# `--name value` match alike.
_CALLBACK = re.compile(r"\0--trainer\.callbacks\+?[=\0]([^\0]*)")
_MODEL_OPTION = re.compile(rf"(\0--model\.(?:init_args\.)?)({'|'.join(KEYS)})(?=[.=\0]|$)")
_VALUE = re.compile(r"(\0--(?:[^=\0]*\.)?([^=.\0]+)[=\0])((?!--)[^\0]*)")


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
        """Return a value of a config, at a path of keys, with current names."""
        if isinstance(value, dict):
            if not path and str(value.get("class_path")).endswith("FluidsNet"):
                # A file given as --model.
                path = ("model",)
            in_model = path[-1:] == ("model",) or path[-2:] in _MODEL_PATHS
            renamed = {}
            for key, item in value.items():
                if key in ("callbacks", "callbacks+") and self._is_removed(item):
                    continue
                name = self._current(key, "block") if in_model and key in KEYS else key
                renamed[name] = self.in_config(item, (*path, str(name)))
            return renamed
        if isinstance(value, list):
            return [self.in_config(item, path) for item in value if not self._is_removed(item)]
        return self._current(value, path[-1]) if path and isinstance(value, str) else value

    def in_arguments(self, arguments: list[str]) -> list[str]:
        """Return command-line arguments with current names."""
        text = "".join(f"\0{argument}" for argument in arguments)
        text = _CALLBACK.sub(lambda match: "" if self._is_removed(match[1]) else match[0], text)
        text = _MODEL_OPTION.sub(lambda match: match[1] + self._current(match[2], "block"), text)
        text = _VALUE.sub(lambda match: match[1] + self._current(match[3], match[2]), text)
        return text.split("\0")[1:]

    def _current(self, value: str, key: str) -> str:
        """Return the current name of the value of a key."""
        if key == "block":
            return self._noted(value, KEYS.get(value, value))
        if key not in _CLASS_KEYS:
            return value
        module, dot, name = value.rpartition(".")
        return self._noted(value, f"{MODULES.get(module, module)}{dot}{CLASSES.get(name, name)}")

    def _noted(self, old: str, new: str) -> str:
        if new != old:
            self._found[old] = new
        return new

    def _is_removed(self, item: Any) -> bool:
        name = item.get("class_path") if isinstance(item, dict) else item
        if not isinstance(name, str) or name not in REMOVED:
            return False
        self._found[name] = "removed"
        return True


def with_current_names(settings: dict[str, Any]) -> dict[str, Any]:
    """Return arguments of `FluidsNet` with current names, without a warning."""
    renamed: dict[str, Any] = DeprecatedNames().in_config(settings, ("model", "init_args"))
    return renamed
