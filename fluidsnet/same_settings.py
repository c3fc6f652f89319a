"""Comparison of blocks by class and settings."""

from __future__ import annotations

from typing import Any

from torch import nn


def same_settings(block: Any, other: Any) -> bool:
    """Return whether blocks agree in class, settings and shapes of weights."""
    return bool(_settings(block) == _settings(other))


def _settings(block: Any) -> Any:
    if isinstance(block, nn.Module):
        return [
            (name, type(part), _attributes(part), [value.shape for value in part.parameters()])
            for name, part in block.named_modules()
        ]
    return type(block), _attributes(block)


def _attributes(part: Any) -> dict[str, Any]:
    return {
        name: value
        for name, value in getattr(part, "__dict__", {}).items()
        if not name.startswith("_") and isinstance(value, bool | int | float | str | tuple | list)
    }
