"""The page of the ablation study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fluidsnet.studies.ablations.claims import claims, rule, warnings
from fluidsnet.studies.ablations.comparison import compare
from fluidsnet.studies.ablations.figures import draw_figures
from fluidsnet.studies.ablations.files import write_files
from fluidsnet.studies.ablations.flatness import FLAT
from fluidsnet.studies.ablations.group import Group, grouped
from fluidsnet.studies.ablations.numbers import MOTION, REST, STARTS, read_numbers
from fluidsnet.studies.ablations.tables import (
    comparison_table,
    cost_line,
    foreign_table,
    one_step_table,
    rollout_table,
    training_table,
)
from fluidsnet.studies.ablations.trained_run import TrainedRun

_PICTURES = {
    "target.png": "Errors of both targets on the validation split, in one unit; thin lines are "
    "seeds. The paper's figure 11 is of this.",
    "global_feature.png": "The same with and without the global feature.",
    "global_feature_energy.png": "Kinetic energy of the rollouts in motion. The paper's figure 12 "
    "shows the velocity field instead.",
}


def write_report(output: Path, runs: Sequence[TrainedRun], planned: int) -> str:
    """Writes ``ablations.md``, its CSV files and its figures.

    Args:
        output: folder that they are written into; it is made.
        runs: those that are finished: trained and tested.
        planned: how many the study has.

    Returns:
        the Markdown.

    Raises:
        UserError: a run's folder is not one of a run, or is named twice.
    """
    output.mkdir(parents=True, exist_ok=True)
    numbers = read_numbers(runs)
    groups = grouped(numbers)
    parts = ["# Ablations\n"]
    if len(runs) < planned:
        parts.append(f"**{len(runs)} of {planned} runs are finished.**\n")
    parts += [f"**{sentence}**\n" for sentence in warnings(groups)]
    parts += [f"{sentence}\n" for one in numbers for sentence in one.missing()]
    if groups:
        comparisons = compare(groups)
        files = write_files(output, groups, comparisons)
        draw_figures(output, groups)
        parts += [
            "Each run trains the paper's network, which predicts the velocity and has the global "
            "feature, and beside it on the same batches two twins: one that predicts the "
            "acceleration, and one without the global feature. Measured are the last weights of "
            "each. Numbers are means ± sample "
            "standard deviations over seeds; of one seed, and where all agree, the value alone. "
            f"In full they are in {', '.join(f'[{name}]({name})' for name in files)}.\n",
            "## The paper's claims (section 5.6)\n",
            claims(groups),
            f"{rule()}\n",
            *(f"![{words}]({name})\n" for name, words in _PICTURES.items()),
            "## Twin beside model\n",
            "Of each figure less is better: above 1 the model is better.\n",
            comparison_table(comparisons),
            "## One step ahead\n",
            "From the true states of the test split.\n",
            *_sections(groups, [one_step_table(group) for group in groups]),
            "## Rollouts from rest\n",
            "From the first frame of each simulation of the test split, to its end.\n",
            *(f"{sentence}\n" for sentence in _times(groups, REST)),
            *_sections(groups, [rollout_table(group, REST) for group in groups]),
            "## Rollouts in motion\n",
            "The same from a quarter of each simulation on, when the fluid is fast.\n",
            *(f"{sentence}\n" for sentence in _times(groups, MOTION)),
            *_sections(groups, [rollout_table(group, MOTION) for group in groups]),
            "## Was training long enough?\n",
            "The mean of the validations' velocity_mse over the last eighth of training, beside "
            f"that over the eighth before; flat is a change below {100 * FLAT:g} %. The worst of "
            "the seeds. A curve is also flat where the learning rate has become small.\n",
            training_table(groups),
            "## Does the network look at its global feature?\n",
            "The model's velocity_mse with the global feature of another frame, drawn at random, "
            "over that with its own: 1 means that it does not.\n",
            foreign_table(groups),
            "## Cost\n",
            f"{cost_line(numbers)}\n",
        ]
    text = "\n".join(parts)
    (output / "ablations.md").write_text(text)
    return text


def _sections(groups: Sequence[Group], tables: Sequence[str]) -> list[str]:
    return [f"### {group.title}\n\n{table}" for group, table in zip(groups, tables, strict=True)]


def _times(groups: Sequence[Group], start: str) -> list[str]:
    """A sentence for each scene whose strides have no rows at the same time."""
    found = []
    for scene in dict.fromkeys(group.scene for group in groups):
        moments = {group.stride: group.moments(start) for group in groups if group.scene == scene}
        for words, index in (("first", 0), ("last", -1)):
            times = {stride: of[index].time for stride, of in moments.items() if len(of) == 2}
            # Times are products of a time step.
            if len({round(time, 6) for time in times.values()}) > 1:
                when = ", ".join(
                    f"after {time:.4g} s at stride {stride}" for stride, time in times.items()
                )
                where = f"{scene}, {STARTS[start]}"
                found.append(f"{where}: the {words} rows are not of the same time, but {when}.")
    return found
