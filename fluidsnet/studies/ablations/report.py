"""Report of the ablation study: ``ablations.md``, with its CSV files and its figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from fluidsnet.studies.ablations import tables
from fluidsnet.studies.ablations.comparison import Ratio, accuracy, compare, paired
from fluidsnet.studies.ablations.figures import draw_figures
from fluidsnet.studies.ablations.results import (
    ACCELERATION,
    ENERGY,
    LABELS,
    MODEL,
    MOTION,
    REST,
    STARTS,
    WITHOUT,
    Group,
    Moment,
    TrainedRun,
    read_groups,
)

#: Share of the truth's kinetic energy below which a velocity field counts as near 0.
_NEAR_ZERO = 0.1
_VERDICTS = {1: "confirmed", -1: "refuted", 0: "not decided"}
_TEXT = """\
Each run trains the paper's network, which predicts the velocity and has the global feature, and \
on the same batches two twins: one that predicts the acceleration, and one without the global \
feature. All are measured with the weights of the last step. Numbers are means ± sample standard \
deviations over the seeds; with one seed, and where all seeds agree, the value alone. All digits \
are in {files}.

## The paper's claims (section 5.6)

**(a)** With the acceleration as predictive output “it is difficult for the model to learn \
reasonable dynamics”: its error is greater.

{acceleration}

**(b)** “The model without global feature would bring the velocity field near 0 iteratively.” The \
paper's figure shows a “random initial state, in iteration and convergence state”. The test here: \
does the kinetic energy of rollouts that start in motion go near 0?

{energy}

**(c)** Not claimed by the paper, but to be expected: without the global feature the error is \
greater.

{without}

For each seed the ratio of the two models' values is taken, on the same frames. The mean is the \
geometric mean; the interval in brackets is its 95 % confidence interval, by Student's t over the \
logarithms. With three or more seeds a difference is decided where the interval excludes 1; with \
fewer seeds it is not decided, and only the ratio is given. An interval covers the effect of the \
training's seed; data and test simulations are the same for all seeds. Intervals are not corrected \
for their number: one in twenty excludes 1 by chance. That the velocity field goes near 0 is \
confirmed where a rollout without the global feature has less kinetic energy than one with it and \
less than {near_zero} times that of the truth; confirmed in part where it has less than one with \
it and less than the truth; refuted where it has more than the truth, or less than the truth and \
more than one with it. Where a value is zero or not finite there is no interval and no decision.

![Validation errors with both targets, in one unit, as in the paper's figure 11; thin lines are \
seeds.](target.png)

![Validation errors with and without the global feature.](global_feature.png)

![Kinetic energy of the rollouts in motion. The paper's figure 12 shows the velocity field \
instead.](global_feature_energy.png)

## Twin beside model

All figures are errors: a ratio above 1 means that the model is better.

{comparison}
## One step ahead

From the true states of the test split.

{one_step}
## Rollouts from rest

From the first frame of each simulation of the test split to its end.

{from_rest}
## Rollouts in motion

From a quarter of each simulation, when the fluid is fast, to its end.

{in_motion}
## Was training long enough?

Change of the mean validation velocity_mse from the 7th to the last eighth of training; flat is a \
change below {flat:g} %. The worst of the seeds is given. A curve is also flat where the learning \
rate has become small.

{training}
## Does the network use its global feature?

The model's velocity_mse with the global feature of another frame, drawn at random, over that with \
the frame's own: 1 means that the network does not use it.

{permutation}
## Cost

{cost}
"""


def write_report(output: Path, runs: Sequence[TrainedRun], planned: int) -> str:
    """Write ``ablations.md``, its CSV files and its figures; return the Markdown.

    Args:
        output: Folder of the files, made if missing.
        runs: The runs that are trained and tested.
        planned: Number of runs of the whole study.

    Raises:
        UserError: A folder is not the folder of a run.
    """
    output.mkdir(parents=True, exist_ok=True)
    groups = read_groups(runs)
    parts = ["# Ablations\n"]
    if len(runs) < planned:
        parts.append(f"**{len(runs)} of {planned} runs are finished.**\n")
    parts += [f"**{sentence}**\n" for sentence in _warnings(groups)]
    parts += [f"{line}\n" for group in groups for run in group.runs for line in run.problems]
    if groups:
        comparisons = compare(groups)
        files = tables.write_csv_files(output, groups, comparisons)
        draw_figures(output, groups)
        moments = [(group, moment) for group in groups for moment in group.moments(MOTION)]
        one_step = [f"### {group.title}\n\n{tables.one_step_table(group)}" for group in groups]
        parts.append(
            _TEXT.format(
                files=", ".join(f"[{name}]({name})" for name in files),
                acceleration=_list(_accuracy_claim(group, ACCELERATION) for group in groups),
                energy=_list(_energy_claim(*moment) for moment in moments),
                without=_list(_accuracy_claim(group, WITHOUT) for group in groups),
                near_zero=_NEAR_ZERO,
                comparison=tables.comparison_table(comparisons),
                one_step="\n".join(one_step),
                from_rest=_rollouts(groups, REST),
                in_motion=_rollouts(groups, MOTION),
                flat=100 * tables.FLAT,
                training=tables.training_table(groups),
                permutation=tables.permutation_table(groups),
                cost=tables.cost_sentence(groups),
            )
        )
    text = "\n".join(parts)
    (output / "ablations.md").write_text(text, "utf-8")
    return text


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


def _rollouts(groups: Sequence[Group], start: str) -> str:
    """Return the tables of rollouts, after a sentence where the times of the strides differ."""
    parts = []
    for scene in dict.fromkeys(group.scene for group in groups):
        moments = {group.stride: group.moments(start) for group in groups if group.scene == scene}
        for name, index in (("first", 0), ("last", -1)):
            times = {stride: pair[index].time for stride, pair in moments.items() if len(pair) == 2}
            # Times are products of a time step, so they are equal up to rounding.
            if len({round(time, 6) for time in times.values()}) > 1:
                where = ", ".join(
                    f"{time:.4g} s at stride {stride}" for stride, time in times.items()
                )
                place = f"{scene}, {STARTS[start]}"
                parts.append(f"{place}: the times of the {name} rows differ: {where}.\n")
    parts += [f"### {group.title}\n\n{tables.rollout_table(group, start)}" for group in groups]
    return "\n".join(parts)


def _list(sentences: Iterable[str]) -> str:
    """Return a Markdown list of the sentences that are not empty."""
    return (
        "\n".join(f"- {sentence}" for sentence in sentences if sentence) or "This was not measured."
    )


def _warnings(groups: Sequence[Group]) -> list[str]:
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


def _below_zero(group: Group, predictor: str) -> bool:
    """Return whether the mean skill on the test split is below 0."""
    skills = group.values(predictor, "skill").values()
    # The negation counts NaN as below 0.
    return bool(skills) and not sum(skills) / len(skills) >= 0


def _accuracy_claim(group: Group, twin: str) -> str:
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


def _energy_claim(group: Group, moment: Moment) -> str:
    without, with_it, truth = (
        group.values(predictor, ENERGY, MOTION, moment.steps)
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
