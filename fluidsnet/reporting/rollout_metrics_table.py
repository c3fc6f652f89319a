"""Table of rollout metrics."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from fluidsnet.metrics.suite import BASELINES, RolloutResults
from fluidsnet.particles import RolloutStarts
from fluidsnet.reporting.rollout_scalars import logged_steps
from fluidsnet.reporting.table import Cell, markdown, write_table

# Name of the metric, header of its column, and factor of its unit.
_COLUMNS = (
    ("position_error_mm", "position_error mm", 1),
    ("position_error_radii", "position_error radii", 1),
    ("mse_n_m2", "mse_n m²", 1),
    ("velocity_mse", "velocity_mse m²/s²", 1),
    ("chamfer_mm", "chamfer mm", 1),
    ("sinkhorn_256_m2", "sinkhorn_256 m²", 1),
    ("kinetic_energy", "kinetic_energy %", 100),
    ("kinetic_energy_j_per_kg", "kinetic_energy J/kg", 1),
    ("center_of_mass", "center_of_mass %", 100),
    ("density_error", "density_error %", 100),
    ("density_error_999", "density_error 99.9th %", 100),
    ("escaped", "escaped %", 100),
    ("non_finite", "non-finite %", 100),
)
# Columns that fit a terminal: header, predictor (None is the row's), metric and factor.
_PRINTED = (
    ("error mm", None, "position_error_mm", 1),
    ("const. velocity mm", "constant_velocity", "position_error_mm", 1),
    ("ballistic mm", "ballistic", "position_error_mm", 1),
    ("chamfer mm", None, "chamfer_mm", 1),
    ("energy %", None, "kinetic_energy", 100),
    ("escaped %", None, "escaped", 100),
)


def write_rollout_metrics(
    path: Path, results: RolloutResults, starts: RolloutStarts, time_step: float
) -> str:
    """Write ``<path>.md`` and ``<path>.csv``, with a row for each predictor and number of steps.

    Args:
        path: Path without a suffix.
        results: Metrics of the rollouts, the models first.
        starts: Starts of the rollouts.
        time_step: s.

    Returns:
        Markdown of the models' rows with fewer columns, and a line for each rollout that became
        non-finite.
    """
    steps = logged_steps(results)
    rows: list[list[Cell]] = []
    for predictor, metrics in results.items():
        for step in steps:
            simulations = int(results["model"]["simulations"][step - 1])
            row: list[Cell] = [predictor.replace("_", " "), step, step * time_step, simulations]
            row += [_cell(metrics, name, step, factor) for name, _, factor in _COLUMNS]
            rows.append(row)
    header = ("predictor", "steps", "time s", "simulations", *(title for _, title, _ in _COLUMNS))
    write_table(path, header, rows)
    models = [predictor for predictor in results if predictor not in BASELINES]
    # A single model needs no name.
    named = len(models) > 1
    printed: list[list[Cell]] = [
        [
            *([model.replace("_", " ")] if named else []),
            step,
            step * time_step,
            *(_cell(results[of or model], name, step, unit) for _, of, name, unit in _PRINTED),
        ]
        for model in models
        for step in steps
    ]
    header = (*(["predictor"] if named else []), "steps", "time s", *(row[0] for row in _PRINTED))
    table = markdown(header, printed)
    broken = [
        f"{'The model' if model == 'model' else model.replace('_', ' ')}'s rollout of /{name} from "
        f"frame {frame} is not finite from step {step:.0f} on."
        for model in models
        for name, frame, step in zip(
            starts.names, starts.first, results[model]["non_finite_step"].tolist(), strict=True
        )
        if step != float("inf")
    ]
    with path.with_suffix(".md").open("a", encoding="utf-8") as file:
        file.writelines(f"\n{line}\n" for line in broken)
    return "\n".join([table.rstrip(), *broken])


def _cell(metrics: Mapping[str, Tensor], name: str, step: int, factor: float) -> Cell:
    """Return a metric after a step; empty where it was not measured (NaN)."""
    value = factor * float(metrics[name][step - 1]) if name in metrics else float("nan")
    return "" if value != value else value
