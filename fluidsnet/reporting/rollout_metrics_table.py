"""Table of rollout metrics."""

from __future__ import annotations

from pathlib import Path

from fluidsnet.metrics.suite import BASELINES, RolloutResults
from fluidsnet.particles import RolloutStarts
from fluidsnet.reporting.rollout_scalars import logged_steps
from fluidsnet.reporting.table import Cell, write_table

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
        Markdown of the models' rows, and a line for each rollout that became non-finite.
    """
    steps = logged_steps(results)
    rows: list[list[Cell]] = []
    for predictor, metrics in results.items():
        for step in steps:
            simulations = int(results["model"]["simulations"][step - 1])
            row: list[Cell] = [predictor.replace("_", " "), step, step * time_step, simulations]
            for name, _, factor in _COLUMNS:
                value = factor * float(metrics[name][step - 1]) if name in metrics else float("nan")
                # NaN was not measured; non-finite states are measured as inf.
                row.append("" if value != value else value)
            rows.append(row)
    header = ("predictor", "steps", "time s", "simulations", *(title for _, title, _ in _COLUMNS))
    lines = write_table(path, header, rows).splitlines()
    models = [predictor for predictor in results if predictor not in BASELINES]
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
    return "\n".join([*lines[: 2 + len(steps) * len(models)], *broken])
