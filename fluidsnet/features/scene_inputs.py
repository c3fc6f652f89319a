"""Values of the scene as input of a network, and the check of those that it was not trained on."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import final

import torch
from torch import Tensor, nn

from fluidsnet.errors import UserError
from fluidsnet.particles import Particles
from fluidsnet.scene import VALUES, Scene

#: Least value of a coefficient that is told from zero, as a share of the greatest trained on.
_LEAST = 1e-3
#: Relative difference between values that count as equal.
_TOLERANCE = 1e-4


@final
class SceneInputs(nn.Module):
    """Columns of the values that vary between the training simulations.

    Each column runs from -1 to 1 over the training split: components of gravity linearly,
    coefficients on a logarithmic scale.

    Args:
        names: Values that are an input, of `fluidsnet.scene.VALUES`.

    Attributes:
        width: Number of columns.

    Raises:
        UserError: There is no value of such a name.
    """

    lower: Tensor
    upper: Tensor

    def __init__(self, names: Sequence[str] = ()) -> None:
        super().__init__()
        for name in names:
            if name not in VALUES:
                raise UserError(f"A scene has no value {name!r}; there are {', '.join(VALUES)}.")
        self.names = tuple(names)
        columns = [column for name in VALUES for column in [name] * VALUES[name]]
        self._columns = [at for at, name in enumerate(columns) if name in self.names]
        self._coefficient = torch.tensor([columns[at] != "gravity" for at in self._columns])
        self.width = len(self._columns)
        # Of all values, also those that are no input; before training there is no limit.
        self.register_buffer("lower", torch.full((len(columns),), -torch.inf))
        self.register_buffer("upper", torch.full((len(columns),), torch.inf))

    def set_range(self, lower: Tensor, upper: Tensor) -> None:
        """Set the least and the greatest of `Scene.values` in the training split, (5,) each."""
        self.lower.copy_(lower)
        self.upper.copy_(upper)

    def forward(self, particles: Particles) -> Tensor:
        """Return the columns of the fluid particles, (N, width)."""
        chosen = self._columns
        values, lower, upper = (
            self._scaled(it[..., chosen]) for it in (particles.scene.values, self.lower, self.upper)
        )
        half = ((upper - lower) / 2).clamp_min(1e-6)
        rows = particles.per_particle((values - lower) / half - 1)
        return rows.expand(len(particles), -1)

    def check(self, scenes: Scene) -> None:
        """Check that the scenes have values that were trained on.

        A value outside the range of one that varied in training is a warning.

        Raises:
            UserError: A value differs from the only one that was trained on.
        """
        lower, upper = self.lower.tolist(), self.upper.tolist()
        for name, row in zip(scenes.names, scenes.values.tolist(), strict=True):
            at = 0
            for value, width in VALUES.items():
                part = slice(at, at + width)
                at += width
                low, high, found = lower[part], upper[part], row[part]
                outside = any(
                    x < a - _TOLERANCE * (1e-3 + abs(a)) or x > b + _TOLERANCE * (1e-3 + abs(b))
                    for x, a, b in zip(found, low, high, strict=True)
                )
                if not outside:
                    continue
                label = value.replace("_", " ")
                if low == high:
                    raise UserError(
                        f"{name}: {label} is {_text(found)}, and this network was trained at "
                        f"{_text(low)} alone; use data of that value, or train on simulations in "
                        f"which it varies."
                    )
                warnings.warn(
                    f"{name}: {label} is {_text(found)}, outside the range of the training data, "
                    f"{_text(low)} to {_text(high)}.",
                    stacklevel=2,
                )

    def _scaled(self, values: Tensor) -> Tensor:
        """Return values (..., width) on their scales."""
        most = self.upper[self._columns].clamp_min(1e-12)
        logarithm = (values.clamp_min(0) / most + _LEAST).log()
        return logarithm.where(self._coefficient.to(values.device), values)


def _text(values: Sequence[float]) -> str:
    numbers = ", ".join(f"{value:.4g}" for value in values)
    return numbers if len(values) == 1 else f"({numbers})"
