"""Report of the ablation study: ``ablations.md``, its CSV files and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fluidsnet.studies.ablations.claims import RULE, claims, warnings
from fluidsnet.studies.ablations.comparison import compare
from fluidsnet.studies.ablations.figures import draw_figures
from fluidsnet.studies.ablations.results import (
    MOTION,
    REST,
    STARTS,
    Group,
    TrainedRun,
    read_groups,
)
from fluidsnet.studies.ablations.tables import (
    FLAT,
    comparison_table,
    cost_sentence,
    one_step_table,
    permutation_table,
    rollout_table,
    training_table,
    write_csv_files,
)

_TEXT = """\
Each run trains the paper's network, which predicts the velocity and has the global feature, and \
on the same batches two twins: one that predicts the acceleration, and one without the global \
feature. All are measured with the weights of the last step. Numbers are means ± sample standard \
deviations over the seeds; with one seed, and where all seeds agree, the value alone. All digits \
are in {files}.

## The paper's claims (section 5.6)

{claims}
{rule}

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
    parts += [f"**{sentence}**\n" for sentence in warnings(groups)]
    parts += [f"{it}\n" for group in groups for run in group.runs for it in run.problems]
    if groups:
        comparisons = compare(groups)
        files = write_csv_files(output, groups, comparisons)
        draw_figures(output, groups)
        one_step = [f"### {group.title}\n\n{one_step_table(group)}" for group in groups]
        parts.append(
            _TEXT.format(
                files=", ".join(f"[{name}]({name})" for name in files),
                claims=claims(groups),
                rule=RULE,
                comparison=comparison_table(comparisons),
                one_step="\n".join(one_step),
                from_rest=_rollouts(groups, REST),
                in_motion=_rollouts(groups, MOTION),
                flat=100 * FLAT,
                training=training_table(groups),
                permutation=permutation_table(groups),
                cost=cost_sentence(groups),
            )
        )
    text = "\n".join(parts)
    (output / "ablations.md").write_text(text, "utf-8")
    return text


def _rollouts(groups: Sequence[Group], start: str) -> str:
    """Return the tables of rollouts, after a sentence where the times of the strides differ."""
    parts = []
    for scene in dict.fromkeys(group.scene for group in groups):
        moments = {group.stride: group.moments(start) for group in groups if group.scene == scene}
        for name, index in (("first", 0), ("last", -1)):
            times = {stride: them[index].time for stride, them in moments.items() if len(them) == 2}
            # Times are products of a time step, so they are equal up to rounding.
            if len({round(time, 6) for time in times.values()}) > 1:
                where = ", ".join(f"{time:.4g} s at stride {it}" for it, time in times.items())
                place = f"{scene}, {STARTS[start]}"
                parts.append(f"{place}: the times of the {name} rows differ: {where}.\n")
    parts += [f"### {group.title}\n\n{rollout_table(group, start)}" for group in groups]
    return "\n".join(parts)
