"""The paper's claims of section 5.6, and what the numbers say of them."""

from __future__ import annotations

from collections.abc import Sequence

from fluidsnet.studies.ablations.comparison import accuracy, paired
from fluidsnet.studies.ablations.group import Group, Moment
from fluidsnet.studies.ablations.numbers import (
    ACCELERATION,
    LABELS,
    MODEL,
    MOTION,
    WITHOUT,
    one_step,
    rollout,
)
from fluidsnet.studies.ablations.ratio import Ratio

#: A velocity field is near 0 with less than this share of the truth's kinetic energy.
NEAR_ZERO = 0.1
_WORDS = {1: "confirmed", -1: "refuted", 0: "not decided"}


def claims(groups: Sequence[Group]) -> str:
    """The claims as Markdown, a sentence for each of a claim's parts, scene and stride."""
    energies = [_energy(group, moment) for group in groups for moment in group.moments(MOTION)]
    parts = (
        (
            "**(a)** With the acceleration as predictive output “it is difficult for the model to "
            "learn reasonable dynamics”: its error is the greater.",
            [_accuracy(group, ACCELERATION) for group in groups],
        ),
        (
            "**(b)** “The model without global feature would bring the velocity field near 0 "
            "iteratively.” The paper's picture is of a “random initial state, in iteration and "
            "convergence state”; here, of rollouts from states in motion, the kinetic energy goes "
            "near 0:",
            energies,
        ),
        (
            "**(c)** The paper does not say so, but one would expect it: without the global "
            "feature the error is the greater.",
            [_accuracy(group, WITHOUT) for group in groups],
        ),
    )
    return "\n".join(
        "\n".join([words, "", *(f"- {sentence}" for sentence in sentences if sentence), ""])
        for words, sentences in parts
        if any(sentences)
    )


def warnings(groups: Sequence[Group]) -> list[str]:
    """A sentence for each group in which every model is worse than doing nothing."""
    found = []
    for group in groups:
        who = [name for name in LABELS if group.values(one_step(name, "skill"))]
        if who and all(below_zero(group, name) for name in who):
            found.append(
                f"{group.scene}, {group.step}: all models lie below skill 0, which is worse than "
                "doing nothing; a comparison among them means little."
            )
    return found


def below_zero(group: Group, who: str) -> bool:
    """Whether a model's skill on the test split, the mean over seeds, is below 0."""
    skills = group.values(one_step(who, "skill"))
    # Not a number is no skill either.
    return bool(skills) and not sum(skills) / len(skills) >= 0


def energy_verdict(share: Ratio, relative: Ratio) -> str:
    """Whether the velocity field goes near 0 without the global feature, and with it less so.

    Args:
        share: the rollouts' kinetic energy without it, over the truth's at the same time.
        relative: the same over that of the rollouts with it.
    """
    if share.side() > 0:
        return "refuted: it has more energy than the truth"
    if share.side() < 0 and relative.side() > 0:
        return "refuted: with the global feature there is even less energy"
    if share.side() < 0 and relative.side() < 0:
        if share.side(NEAR_ZERO) < 0:
            return "confirmed"
        return "confirmed in part: it has less energy than the truth, but is not near 0"
    return "not decided"


def _accuracy(group: Group, twin: str) -> str:
    ratio = accuracy(group, twin)
    if not ratio.each:
        return ""
    whose = {
        ACCELERATION: "the acceleration's velocity_mse is {} times the velocity's{}",
        WITHOUT: "without the global feature velocity_mse is {} times that with it{}",
    }[twin]
    # "0.5 [0.4, 0.6]": the interval comes last.
    mean, space, interval = str(ratio).partition(" ")
    words = f"{_where(group)}: {_WORDS[ratio.side()]}: {whose.format(mean, space + interval)}."
    if below_zero(group, MODEL) and below_zero(group, twin):
        words += " Both lie below skill 0, worse than doing nothing."
    return words


def _energy(group: Group, moment: Moment) -> str:
    without, with_it, truth = (
        rollout(who, moment.steps, "kinetic_energy J/kg", MOTION)
        for who in (WITHOUT, MODEL, "truth")
    )
    share, relative = paired(group, without, truth), paired(group, without, with_it)
    if not relative.each:
        return ""
    return (
        f"{_where(group)}, after {moment.time:.4g} s: {energy_verdict(share, relative)}: without "
        f"the global feature a rollout has {share} times the truth's kinetic energy, with it "
        f"{paired(group, with_it, truth)} times; without over with is {relative}."
    )


def _where(group: Group) -> str:
    return f"At {group.step} ({group.scene}, {group.seeds})"


def rule() -> str:
    """How it is decided, in words."""
    return (
        "Of each seed the ratio of the two models' figures is taken, on the same frames; the mean "
        "is the geometric one, and the interval in brackets its 95 % confidence interval, of "
        "Student's t over the logarithms. With three or more seeds a difference is decided where "
        "the interval excludes 1; with fewer it is not decided, and the ratio alone is given. "
        "An interval covers what another seed of the training would change; the data, and the "
        "simulations of the test, are the same for all. "
        "Each interval stands by itself: one in twenty excludes 1 by chance. That the velocity "
        "field goes near 0 is confirmed where a rollout without the global feature has less "
        f"kinetic energy than one with it and less than {NEAR_ZERO} times the truth's, and in "
        "part where it has less than one with it and less than the truth; it is refuted where it "
        "has more than the truth, or less than the truth and more than one with it. Where a "
        "figure is zero or not finite there is no interval, and nothing is decided."
    )
