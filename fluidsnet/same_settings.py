"""Whether two blocks are the same but for their weights."""

from __future__ import annotations

from typing import Any

from torch import nn


def same_settings(block: Any, other: Any) -> bool:
    """Whether two blocks are of one class, with equal settings and weights of equal shapes."""
    return bool(_settings(block) == _settings(other))


def _settings(block: Any) -> Any:
    if isinstance(block, nn.Module):
        return [
            (name, type(part), _plain(part), [weight.shape for weight in part.parameters()])
            for name, part in block.named_modules()
        ]
    return type(block), _plain(block)


def _plain(part: Any) -> dict[str, Any]:
    return {
        name: value
        for name, value in getattr(part, "__dict__", {}).items()
        if not name.startswith("_") and isinstance(value, bool | int | float | str | tuple | list)
    }
