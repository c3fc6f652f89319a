"""Each twin set beside the model that it was trained with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fluidsnet.studies.ablations.group import Group
from fluidsnet.studies.ablations.numbers import (
    ACCELERATION,
    MODEL,
    WITHOUT,
    Lookup,
    one_step,
    rollout,
)
from fluidsnet.studies.ablations.ratio import Ratio

#: What is compared of rollouts from rest, after their last step.
_ROLLOUT = ("position_error mm", "chamfer mm")


@dataclass(frozen=True)
class Comparison:
    """A twin's figure over the model's.

    Attributes:
        twin: its name.
        group: the runs.
        figure: of both, in words.
        ratio: of the figures, above 1 where the model is better.
    """

    twin: str
    group: Group
    figure: str
    ratio: Ratio

    @property
    def decision(self) -> str:
        """Which is better, in words."""
        words = {1: "the model is better", -1: "the twin is better", 0: "not decided"}
        return words[self.ratio.side()]


def paired(group: Group, one: Lookup, other: Lookup) -> Ratio:
    """One number over another, for each seed that has both."""
    pairs = [(one(run), other(run)) for run in group.runs]
    return Ratio.of([(a, b) for a, b in pairs if a is not None and b is not None])


def accuracy(group: Group, twin: str) -> Ratio:
    """A twin's `velocity_mse` over the model's, one step ahead on the test split."""
    mine, other = (one_step(who, "velocity_mse m²/s²") for who in (MODEL, twin))
    return paired(group, other, mine)


def compare(groups: Sequence[Group]) -> list[Comparison]:
    """All that is compared, of each twin in each group that has it."""
    found = []
    for twin in (ACCELERATION, WITHOUT):
        for group in groups:
            ratios = {"velocity_mse, one step": accuracy(group, twin)}
            for moment in group.moments()[-1:]:
                for column in _ROLLOUT:
                    name = f"{column.partition(' ')[0]}, {moment.time:.4g} s"
                    mine, other = (rollout(who, moment.steps, column) for who in (MODEL, twin))
                    ratios[name] = paired(group, other, mine)
            found += [
                Comparison(twin, group, figure, ratio)
                for figure, ratio in ratios.items()
                if ratio.each
            ]
    return found
