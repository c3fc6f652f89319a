"""The tables of the ablation study."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean, median, stdev

from fluidsnet.report.tables import NONE, near, shown
from fluidsnet.reporting.table import Cell, markdown
from fluidsnet.studies.ablations.comparison import Comparison
from fluidsnet.studies.ablations.flatness import Flatness, worst
from fluidsnet.studies.ablations.group import Group
from fluidsnet.studies.ablations.numbers import (
    ACCELERATION,
    LABELS,
    MODEL,
    REST,
    WITHOUT,
    Numbers,
    one_step,
    rollout,
)
from fluidsnet.studies.ablations.ratio import digits

ONE_STEP = ("skill", "velocity_mse m²/s²", "position_error_1 mm")
#: A column of the tables of rollouts, and its name here.
ROLLOUT = {
    "position_error mm": "position_error mm",
    "chamfer mm": "chamfer mm",
    "kinetic_energy J/kg": "kinetic_energy J/kg",
    "kinetic_energy %": "kinetic_energy error %",
    "density_error %": "density_error %",
    "escaped %": "escaped %",
    "non-finite %": "non-finite %",
}
_TRIVIAL = ("constant velocity", "ballistic")
#: All that stand in a table, and their names for a reader.
ONE_STEP_ROWS = {**LABELS, **{name: name for name in _TRIVIAL}}
ROLLOUT_ROWS = {**ONE_STEP_ROWS, "integrator floor": "integrator floor", "truth": "truth"}


def spread(values: Sequence[float], seeds: int) -> str:
    """Mean ± sample standard deviation; what is not finite is said to be so.

    Args:
        values: one a seed that has one.
        seeds: how many there are; where fewer have a value, this is said.
    """
    if not values:
        return NONE
    count = "" if len(values) == seeds else f" ({len(values)} of {seeds} seeds)"
    if len(values) == 1:
        return shown(values[0]) + count
    broken = [value for value in values if not math.isfinite(value)]
    if broken:
        return f"{broken[0]:g} in {len(broken)} of {len(values)} seeds{count}"
    if all(near(values[0], value) for value in values):
        return shown(fmean(values)) + count
    return f"{_with_deviation(fmean(values), stdev(values))}{count}"


def one_step_table(group: Group) -> str:
    """Each predictor one step ahead from the true states of the test split."""
    rows: list[list[Cell]] = []
    for who, label in ONE_STEP_ROWS.items():
        found = [group.values(one_step(who, column)) for column in ONE_STEP]
        if any(found):
            rows.append([label, *(spread(values, len(group.runs)) for values in found)])
    return markdown(("one step ahead", *ONE_STEP), rows) if rows else "No test was run.\n"


def rollout_table(group: Group, start: str = REST) -> str:
    """Each predictor's rollouts, at the moments of the group.

    Args:
        group: the runs.
        start: the table of the rollouts.
    """
    header = ["time s", "steps", "rollout", *ROLLOUT.values()]
    # Beside the predictor's own.
    place = header.index("kinetic_energy J/kg") + 1
    header.insert(place, "truth's J/kg")
    rows: list[list[Cell]] = []
    for moment in group.moments(start):
        for who, label in ROLLOUT_ROWS.items():
            found = [group.values(rollout(who, moment.steps, column, start)) for column in ROLLOUT]
            if not any(found):
                continue
            truth = group.values(rollout("truth", moment.steps, "kinetic_energy J/kg", start))
            found.insert(place - 3, truth)
            cells = [spread(values, len(group.runs)) for values in found]
            rows.append([moment.time, moment.steps, label, *cells])
    return markdown(header, rows) if rows else "No rollouts were measured.\n"


def comparison_table(comparisons: Sequence[Comparison]) -> str:
    """What decides: a row a comparison."""
    header = (
        "twin", "scene", "step", "figure", "seeds", "twin / model", "95 % from", "to",
        "each seed", "decided",
    )  # fmt: skip
    rows: list[list[Cell]] = []
    for one in comparisons:
        lower, upper = one.ratio.interval or (None, None)
        rows.append(
            [
                LABELS[one.twin],
                one.group.scene,
                one.group.step,
                one.figure,
                len(one.ratio.each),
                digits(one.ratio.mean),
                NONE if lower is None else digits(lower),
                NONE if upper is None else digits(upper),
                ", ".join(map(digits, one.ratio.each)),
                one.decision,
            ]
        )
    return markdown(header, rows) if rows else "There is nothing to compare.\n"


def training_table(groups: Sequence[Group]) -> str:
    """Whether the models were trained until they learned no more, the worst of the seeds."""
    rows: list[list[Cell]] = []
    for group in groups:
        steps = [run.training_steps for run in group.runs]
        counts = [len(run.curve("velocity_mse", MODEL)) for run in group.runs]
        ends = [
            str(worst([Flatness.of(run.curve("velocity_mse", who), run.training_steps)
                       for run in group.runs]))
            for who in LABELS
        ]  # fmt: skip
        known = dict.fromkeys(run.rates for run in group.runs if run.rates is not None)
        rates = ", ".join(f"{first:.2g} to {last:.2g}" for first, last in known) or NONE
        rows.append([group.scene, group.step, min(steps), rates, min(counts), *ends])
    header = ("scene", "step", "training steps", "learning rate", "validations")
    return markdown((*header, *LABELS.values()), rows)


def foreign_table(groups: Sequence[Group]) -> str:
    """How much worse the model is with the global feature of another frame."""
    rows: list[list[Cell]] = []
    for group in groups:
        found = group.values(lambda run: run.foreign_ratio)
        rows.append([group.scene, group.step, len(found), spread(found, len(group.runs))])
    return markdown(("scene", "step", "seeds", "velocity_mse / own"), rows)


def cost_line(runs: Sequence[Numbers]) -> str:
    """What a training step of each twin takes, over the model's."""
    words = {ACCELERATION: "with the acceleration target", WITHOUT: "without the global feature"}
    parts = []
    for twin, name in words.items():
        pairs = [(run.step_seconds(twin), run.step_seconds(MODEL)) for run in runs]
        ratios = [one / two for one, two in pairs if one is not None and two]
        if ratios:
            parts.append(f"{digits(median(ratios))} times as long {name} (of {len(ratios)} runs)")
    if not parts:
        return "No times of training steps were logged."
    return (
        f"Beside the model's, a training step takes, in the median, {' and '.join(parts)}: on "
        "each run's first batch, the models by turns."
    )


def _with_deviation(mean: float, deviation: float) -> str:
    """Both to the deviation's second digit."""
    place = 1 - math.floor(math.log10(deviation))
    if place > 7:
        return f"{mean:.4g} ± {deviation:.2g}"
    mean, deviation = round(mean, place), round(deviation, place)
    return f"{mean:,.{max(place, 0)}f} ± {deviation:,.{max(place, 0)}f}"
