"""Claims of the paper's section 5.6, and whether the measured ratios support them."""

from __future__ import annotations

from collections.abc import Sequence

from fluidsnet.studies.ablations.comparison import Ratio, accuracy, paired
from fluidsnet.studies.ablations.results import (
    ACCELERATION,
    LABELS,
    MODEL,
    MOTION,
    WITHOUT,
    Group,
    Moment,
)

#: Share of the truth's kinetic energy below which a velocity field counts as near 0.
_NEAR_ZERO = 0.1
_VERDICTS = {1: "confirmed", -1: "refuted", 0: "not decided"}
#: How a claim is decided.
RULE = (
    "For each seed the ratio of the two models' values is taken, on the same frames. The mean is "
    "the geometric mean; the interval in brackets is its 95 % confidence interval, by Student's t "
    "over the logarithms. With three or more seeds a difference is decided where the interval "
    "excludes 1; with fewer seeds it is not decided, and only the ratio is given. An interval "
    "covers the effect of the training's seed; data and test simulations are the same for all "
    "seeds. Intervals are not corrected for their number: one in twenty excludes 1 by chance. "
    "That the velocity field goes near 0 is confirmed where a rollout without the global feature "
    f"has less kinetic energy than one with it and less than {_NEAR_ZERO} times that of the truth; "
    "confirmed in part where it has less than one with it and less than the truth; refuted where "
    "it has more than the truth, or less than the truth and more than one with it. Where a value "
    "is zero or not finite there is no interval and no decision."
)


def claims(groups: Sequence[Group]) -> str:
    """Return the claims as Markdown, with a sentence per scene, stride and time."""
    energies = [_energy(group, moment) for group in groups for moment in group.moments(MOTION)]
    parts = (
        (
            "**(a)** With the acceleration as predictive output “it is difficult for the model to "
            "learn reasonable dynamics”: its error is greater.",
            [_accuracy(group, ACCELERATION) for group in groups],
        ),
        (
            "**(b)** “The model without global feature would bring the velocity field near 0 "
            "iteratively.” The paper's figure shows a “random initial state, in iteration and "
            "convergence state”. The test here: does the kinetic energy of rollouts that start in "
            "motion go near 0?",
            energies,
        ),
        (
            "**(c)** Not claimed by the paper, but to be expected: without the global feature the "
            "error is greater.",
            [_accuracy(group, WITHOUT) for group in groups],
        ),
    )
    return "\n".join(
        "\n".join([claim, "", *(f"- {sentence}" for sentence in sentences if sentence), ""])
        for claim, sentences in parts
        if any(sentences)
    )


def warnings(groups: Sequence[Group]) -> list[str]:
    """Return a sentence for each group in which all models have a negative skill."""
    sentences = []
    for group in groups:
        names = [name for name in LABELS if group.values(name, "skill")]
        if names and all(_below_zero(group, name) for name in names):
            sentences.append(
                f"{group.scene}, {group.step}: the skill of all models is below 0, which is worse "
                "than the trivial predictors; comparing the models means little."
            )
    return sentences


def energy_verdict(share: Ratio, relative: Ratio) -> str:
    """Decide whether the velocity field goes near 0 without the global feature.

    Args:
        share: Kinetic energy of rollouts without it over that of the truth at the same time.
        relative: The same over that of rollouts with it.
    """
    if share.side() > 0:
        return "refuted: it has more energy than the truth"
    if share.side() < 0 and relative.side() > 0:
        return "refuted: with the global feature there is even less energy"
    if share.side() < 0 and relative.side() < 0:
        if share.side(_NEAR_ZERO) < 0:
            return "confirmed"
        return "confirmed in part: it has less energy than the truth, but is not near 0"
    return "not decided"


def _below_zero(group: Group, predictor: str) -> bool:
    """Return whether the mean skill on the test split is below 0."""
    skills = group.values(predictor, "skill").values()
    # The negation counts NaN as below 0.
    return bool(skills) and not sum(skills) / len(skills) >= 0


def _accuracy(group: Group, twin: str) -> str:
    ratio = accuracy(group, twin)
    if not ratio.each:
        return ""
    sentence = {
        ACCELERATION: f"velocity_mse with the acceleration target is {ratio} times that with the "
        "velocity target.",
        WITHOUT: f"velocity_mse without the global feature is {ratio} times that with it.",
    }[twin]
    if _below_zero(group, MODEL) and _below_zero(group, twin):
        sentence += " The skill of both is below 0, worse than the trivial predictors."
    return f"{_place(group)}: {_VERDICTS[ratio.side()]}: {sentence}"


def _energy(group: Group, moment: Moment) -> str:
    without, with_it, truth = (
        group.values(predictor, "kinetic_energy J/kg", MOTION, moment.steps)
        for predictor in (WITHOUT, MODEL, "truth")
    )
    share, relative = paired(without, truth), paired(without, with_it)
    if not relative.each:
        return ""
    return (
        f"{_place(group)}, after {moment.time:.4g} s: {energy_verdict(share, relative)}: a rollout "
        f"without the global feature has {share} times the truth's kinetic energy, one with it "
        f"{paired(with_it, truth)} times; the ratio of the two is {relative}."
    )


def _place(group: Group) -> str:
    return f"At {group.step} ({group.scene}, {group.seeds})"
