"""Tables of the ablation study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from statistics import fmean, stdev

import pandas as pd

from fluidsnet.report.events import RATE
from fluidsnet.report.tables import NONE, near, shown
from fluidsnet.reporting.table import markdown
from fluidsnet.studies.ablations.comparison import digits
from fluidsnet.studies.ablations.results import (
    COST,
    ENERGY,
    LABELS,
    MODEL,
    MSE,
    ONE_STEP,
    PERMUTATION,
    RUN,
    Group,
)

#: Relative change of a validation error below which a curve is flat.
FLAT = 0.05
#: Metrics of the study's tables.
ONE_STEP_METRICS = ["skill", MSE, "position_error_1 mm"]
ROLLOUT_METRICS = [
    "position_error mm", "chamfer mm", ENERGY, "kinetic_energy %", "density_error %", "escaped %",
    "non-finite %",
]  # fmt: skip
#: Labels of the rows by predictor.
ROWS = LABELS | {
    name: name for name in ("constant velocity", "ballistic", "integrator floor", "truth")
}
#: Columns of the runs' tables that have another name in the study's tables.
RENAMED = {"kinetic_energy %": "kinetic_energy error %"}


def spread(values: Iterable[float], seeds: int) -> str:
    """Format mean ± sample standard deviation; say so where values are not finite.

    Args:
        values: One per seed that has one.
        seeds: Number of seeds; named in the text where some have no value.
    """
    values = [*values]
    if not values:
        return NONE
    count = "" if len(values) == seeds else f" ({len(values)} of {seeds} seeds)"
    infinite = [value for value in values if not math.isfinite(value)]
    if infinite and len(values) > 1:
        return f"{infinite[0]:g} in {len(infinite)} of {len(values)} seeds{count}"
    mean = fmean(values)
    # Predictors without weights give equal values up to rounding.
    if len(values) == 1 or all(near(value, values[0]) for value in values):
        return f"{shown(mean)}{count}"
    # Both to the second digit of the deviation.
    deviation = stdev(values)
    place = 1 - math.floor(math.log10(deviation))
    if place > 7:
        return f"{mean:.4g} ± {deviation:.2g}{count}"
    mean, deviation = round(mean, place), round(deviation, place)
    return f"{mean:,.{max(place, 0)}f} ± {deviation:,.{max(place, 0)}f}{count}"


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


def _markdown(table: pd.DataFrame, otherwise: str = "") -> str:
    """Return a table as Markdown, or a sentence where it has no rows."""
    rows = table.to_numpy(dtype=object).tolist()
    return markdown([*table.columns], rows) if rows else f"{otherwise}\n"


def _spreads(group: Group, name: str, metrics: list[str]) -> pd.DataFrame:
    """Return a table's metrics over the seeds as text, with a row per moment and predictor."""
    rows = group.at_moments(name)
    cells = rows.groupby(["steps", "predictor", "metric"])["value"].agg(
        lambda values: spread(values, len(group.seeds))
    )
    index = pd.MultiIndex.from_product([[*dict(group.moments(name))], [*ROWS]])
    table = cells.unstack("metric").reindex(index=index, columns=metrics).dropna(how="all")
    return table.fillna(NONE).rename_axis(index=["steps", "rollout"]).reset_index()


def one_step_table(group: Group) -> str:
    """Return the metrics of each predictor one step ahead from true states."""
    table = _spreads(group, ONE_STEP, ONE_STEP_METRICS).drop(columns="steps")
    table = table.replace({"rollout": ROWS})
    return _markdown(table.rename(columns={"rollout": "one step ahead"}), "No test was run.")


def rollout_table(group: Group, start: str) -> str:
    """Return the metrics of each predictor's rollouts at the moments of a table."""
    table = _spreads(group, start, ROLLOUT_METRICS)
    truth = table[table["rollout"] == "truth"].set_index("steps")[ENERGY]
    place = [*table.columns].index(ENERGY) + 1
    table.insert(place, "truth's J/kg", table["steps"].map(truth).fillna(NONE))
    table.insert(0, "time s", table["steps"].map(dict(group.moments(start))))
    table = table.rename(columns=RENAMED).replace({"rollout": ROWS})
    return _markdown(table, "No rollouts were measured.")


def different_times(groups: Sequence[Group], start: str) -> dict[tuple[str, str], pd.Series]:
    """Return times in s by stride that differ, for each scene and its first and last rows."""
    rows = [
        (group.scene, name, group.stride, time)
        for group in groups
        # A single moment is the last, and the first too.
        if len(moments := group.moments(start)) == 2
        for name, (_, time) in zip(("first", "last"), moments, strict=True)
    ]
    table = pd.DataFrame(rows, columns=["scene", "name", "stride", "time"]).set_index("stride")
    times = dict([*table.groupby(["scene", "name"])["time"]])
    # Times are products of a time step, so they are equal up to rounding.
    return {key: values for key, values in times.items() if values.round(6).nunique() > 1}


def comparison_table(comparisons: pd.DataFrame) -> str:
    """Return the rows of `compare` as Markdown."""
    table = comparisons.drop(columns="stride").replace({"twin": LABELS})
    for name in ("twin / model", "from", "to"):
        table[name] = table[name].map(digits)
    table["each seed"] = [
        ", ".join(map(digits, map(float, it.split()))) for it in table["each seed"]
    ]
    table = table.replace({"from": "nan", "to": "nan"}, NONE).rename(columns={"from": "95 % from"})
    return _markdown(table, "There is nothing to compare.")


def training_table(groups: Sequence[Group]) -> str:
    """Return each group's training length, and how its validation errors end."""
    rows = []
    for group in groups:
        curves = {name: group.curves("velocity_mse", name) for name in LABELS}
        ends = [
            describe_change(worst_change(map(final_change, curves[name], group.training_steps)))
            for name in LABELS
        ]
        rates = [
            f"{rate.iloc[0]:.2g} to {rate.iloc[-1]:.2g}" for rate in group.curves(RATE) if len(rate)
        ]
        steps, validations = min(group.training_steps), min(map(len, curves[MODEL]))
        rate = ", ".join(dict.fromkeys(rates)) or NONE
        rows.append((group.scene, group.step, steps, rate, validations, *ends))
    header = ["scene", "step", "training steps", "learning rate", "validations", *LABELS.values()]
    return _markdown(pd.DataFrame(rows, columns=header))


def permutation_table(groups: Sequence[Group]) -> str:
    """Return how much the error grows with the global feature of another frame."""
    metric = "velocity_mse / own"
    rows = [
        (group.scene, group.step, len(values), spread(values, len(group.seeds)))
        for group in groups
        for values in [group.values("another frame", metric, PERMUTATION)]
    ]
    return _markdown(pd.DataFrame(rows, columns=["scene", "step", "seeds", metric]))


def costs(groups: Sequence[Group]) -> pd.DataFrame:
    """Return the time of each model's training step over that of the model, for each run."""
    rows = pd.concat([group.rows for group in groups])
    rows = rows[rows["metric"] == COST].drop_duplicates([*RUN, "predictor"], keep="last")
    seconds = rows.pivot(index=RUN, columns="predictor", values="value").reindex(columns=[*LABELS])
    return seconds.div(seconds[MODEL].replace(0, math.nan), axis="index")
