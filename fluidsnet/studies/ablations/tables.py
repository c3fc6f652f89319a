"""Tables of the ablation study, in Markdown and CSV."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean, median, stdev

import pandas as pd

from fluidsnet.report.tables import NONE, near, shown
from fluidsnet.reporting.table import Cell, markdown
from fluidsnet.studies.ablations.comparison import Comparison, digits
from fluidsnet.studies.ablations.results import (
    ACCELERATION,
    ENERGY,
    LABELS,
    MODEL,
    ONE_STEP,
    PERMUTATION,
    STARTS,
    WITHOUT,
    Group,
)

#: Relative change of a validation error below which a curve is flat.
FLAT = 0.05
_ONE_STEP_METRICS = ("skill", "velocity_mse m²/s²", "position_error_1 mm")
#: Columns of the runs' tables of rollouts, and their names in the study's tables.
_ROLLOUT_METRICS = {
    "position_error mm": "position_error mm",
    "chamfer mm": "chamfer mm",
    ENERGY: ENERGY,
    "kinetic_energy %": "kinetic_energy error %",
    "density_error %": "density_error %",
    "escaped %": "escaped %",
    "non-finite %": "non-finite %",
}
#: Labels of the rows by predictor.
_ONE_STEP_ROWS = {**LABELS, **{name: name for name in ("constant velocity", "ballistic")}}
_ROLLOUT_ROWS = {**_ONE_STEP_ROWS, **{name: name for name in ("integrator floor", "truth")}}


def spread(values: Iterable[float], seeds: int) -> str:
    """Format mean ± sample standard deviation; say so where values are not finite.

    Args:
        values: One per seed that has one.
        seeds: Number of seeds; named in the text where some have no value.
    """
    values = list(values)
    if not values:
        return NONE
    count = "" if len(values) == seeds else f" ({len(values)} of {seeds} seeds)"
    infinite = [value for value in values if not math.isfinite(value)]
    if infinite and len(values) > 1:
        return f"{infinite[0]:g} in {len(infinite)} of {len(values)} seeds{count}"
    mean = fmean(values)
    # Predictors without weights give equal values up to rounding.
    if all(near(value, values[0]) for value in values):
        return f"{shown(mean)}{count}"
    # Both to the second digit of the deviation.
    deviation = stdev(values)
    place = 1 - math.floor(math.log10(deviation))
    if place > 7:
        return f"{mean:.4g} ± {deviation:.2g}{count}"
    mean, deviation = round(mean, place), round(deviation, place)
    return f"{mean:,.{max(place, 0)}f} ± {deviation:,.{max(place, 0)}f}{count}"


def one_step_table(group: Group) -> str:
    """Return the metrics of each predictor one step ahead from true states."""
    rows: list[list[Cell]] = []
    for name, label in _ONE_STEP_ROWS.items():
        values = [group.values(name, metric) for metric in _ONE_STEP_METRICS]
        if any(values):
            rows.append([label, *(spread(cell.values(), len(group.runs)) for cell in values)])
    return markdown(("one step ahead", *_ONE_STEP_METRICS), rows) if rows else "No test was run.\n"


def rollout_table(group: Group, start: str) -> str:
    """Return the metrics of each predictor's rollouts at the group's moments.

    Args:
        group: The runs.
        start: Table of the rollouts.
    """
    header = ["time s", "steps", "rollout", *_ROLLOUT_METRICS.values()]
    place = header.index(ENERGY) + 1
    header.insert(place, "truth's J/kg")
    rows: list[list[Cell]] = []
    for steps, time in group.moments(start):
        truth = group.values("truth", ENERGY, start, steps)
        for name, label in _ROLLOUT_ROWS.items():
            values = [group.values(name, metric, start, steps) for metric in _ROLLOUT_METRICS]
            if any(values):
                values.insert(place - 3, truth)
                cells = [spread(cell.values(), len(group.runs)) for cell in values]
                rows.append([time, steps, label, *cells])
    return markdown(header, rows) if rows else "No rollouts were measured.\n"


def comparison_table(comparisons: Sequence[Comparison]) -> str:
    """Return the comparisons, one per row."""
    header = (
        "twin", "scene", "step", "figure", "seeds", "twin / model", "95 % from", "to",
        "each seed", "decided",
    )  # fmt: skip
    rows: list[list[Cell]] = []
    for comparison in comparisons:
        group, ratio = comparison.group, comparison.ratio
        place = (LABELS[comparison.twin], group.scene, group.step, comparison.metric)
        interval = map(digits, ratio.interval) if ratio.interval else (NONE, NONE)
        each = ", ".join(map(digits, ratio.each))
        numbers = (len(ratio.each), digits(ratio.mean), *interval, each)
        rows.append([*place, *numbers, comparison.decision])
    return markdown(header, rows) if rows else "There is nothing to compare.\n"


def training_table(groups: Sequence[Group]) -> str:
    """Return each group's training length, and how its validation errors end."""
    rows: list[list[Cell]] = []
    for group in groups:
        steps = min(run.training_steps for run in group.runs)
        validations = min(len(run.curve("velocity_mse", MODEL)) for run in group.runs)
        rates = dict.fromkeys(run.learning_rates for run in group.runs if run.learning_rates)
        rates_text = ", ".join(f"{first:.2g} to {last:.2g}" for first, last in rates) or NONE
        ends = []
        for name in LABELS:
            changes = [
                final_change(run.curve("velocity_mse", name), run.training_steps)
                for run in group.runs
            ]
            ends.append(describe_change(worst_change(changes)))
        rows.append([group.scene, group.step, steps, rates_text, validations, *ends])
    header = ("scene", "step", "training steps", "learning rate", "validations")
    return markdown((*header, *LABELS.values()), rows)


def final_change(curve: pd.Series[float], steps: int) -> float:
    """Return the relative change of a curve's mean from the 7th to the last eighth of training.

    NaN where a mean is not finite; infinite where an eighth has no point.

    Args:
        curve: Values by training step; the first step is 0.
        steps: Number of training steps.
    """
    # In integers, since a validation may fall on a boundary; it then belongs to the part it ends.
    eighths = 8 * (curve.index.to_numpy(dtype=int) + 1)
    last = curve[eighths > 7 * steps]
    before = curve[(eighths > 6 * steps) & (eighths <= 7 * steps)]
    if last.empty or before.empty:
        return math.inf
    new, old = float(last.mean(skipna=False)), float(before.mean(skipna=False))
    return new / old - 1 if math.isfinite(new) and math.isfinite(old) and old > 0 else math.nan


def describe_change(change: float) -> str:
    """Describe a `final_change` in words."""
    if not math.isfinite(change):
        return "not finite" if math.isnan(change) else "too few validations"
    if abs(change) < FLAT:
        return "flat"
    return f"{'falls' if change < 0 else 'rises'} {100 * abs(change):.2g} %"


def worst_change(changes: Iterable[float]) -> float:
    """Return the largest change; infinity and then NaN come before all others."""
    return max(changes, key=lambda change: (math.isinf(change), math.isnan(change), abs(change)))


def permutation_table(groups: Sequence[Group]) -> str:
    """Return how much the error grows with the global feature of another frame."""
    metric = "velocity_mse / own"
    rows: list[list[Cell]] = []
    for group in groups:
        values = group.values("another frame", metric, PERMUTATION).values()
        rows.append([group.scene, group.step, len(values), spread(values, len(group.runs))])
    return markdown(("scene", "step", "seeds", metric), rows)


def cost_sentence(groups: Sequence[Group]) -> str:
    """Return the cost of each twin's training step in units of the model's."""
    labels = {ACCELERATION: "with the acceleration target", WITHOUT: "without the global feature"}
    runs = [run for group in groups for run in group.runs]
    parts = []
    for twin, label in labels.items():
        curves = [[run.curve("cost/step_seconds", name) for name in (twin, MODEL)] for run in runs]
        ratios = [
            seconds.iloc[-1] / base.iloc[-1]
            for seconds, base in curves
            if not seconds.empty and not base.empty and base.iloc[-1]
        ]
        if ratios:
            parts.append(f"{digits(median(ratios))} times as long {label} ({len(ratios)} runs)")
    if not parts:
        return "No times of training steps were logged."
    return (
        f"A training step takes {' and '.join(parts)} as that of the model: the median over the "
        "runs, measured on the first batch of each, the models in turn."
    )


def write_csv_files(
    folder: Path, groups: Sequence[Group], comparisons: Sequence[Comparison]
) -> list[str]:
    """Write the tables with all digits and a row per seed; return the files' names."""
    run = ["scene", "stride", "seed"]
    one_step = pd.concat([group.tables[ONE_STEP] for group in groups])
    rollouts = pd.concat(
        [
            rows[rows["steps"].isin([moment.steps for moment in group.moments(start)])]
            for group in groups
            for start, label in STARTS.items()
            for rows in [group.tables[start].assign(start=label)]
        ]
    )
    one_step = one_step[one_step["predictor"].isin(_ONE_STEP_ROWS)]
    rollouts = rollouts[rollouts["predictor"].isin(_ROLLOUT_ROWS)]
    rollouts = rollouts.reindex(
        columns=[*run, "start", "predictor", "steps", "time s", *_ROLLOUT_METRICS]
    )
    header = [
        "twin", "scene", "stride", "figure", "seeds", "twin / model", "from", "to", "each seed",
        "decided",
    ]  # fmt: skip
    rows = [
        (row.twin, row.group.scene, row.group.stride, row.metric, len(row.ratio.each),
         row.ratio.mean, *(row.ratio.interval or ("", "")),
         " ".join(map(repr, row.ratio.each)), row.decision)
        for row in comparisons
    ]  # fmt: skip
    files = {
        "ablations.csv": pd.DataFrame(rows, columns=header),
        "ablations_one_step.csv": one_step.reindex(columns=[*run, "predictor", *_ONE_STEP_METRICS]),
        "ablations_rollouts.csv": rollouts.rename(columns=_ROLLOUT_METRICS),
    }
    for name, table in files.items():
        table.to_csv(folder / name, index=False)
    return list(files)
