"""The table of the rollouts' metrics."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fluidsnet.metrics.rollout_suite import BESIDE, Figures
from fluidsnet.particles import RolloutStarts
from fluidsnet.reporting.table import Cell, write_table

# A metric's name, its column, and what its number is multiplied by.
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
    path: Path, figures: Figures, starts: RolloutStarts, steps: Sequence[int], time_step: float
) -> str:
    """Writes ``<path>.md`` and ``<path>.csv``, a row a predictor and number of steps.

    Args:
        path: without an ending.
        figures: of the rollouts.
        starts: of the same.
        steps: that have a row.
        time_step: s.

    Returns:
        Markdown of the models' rows, and a line for each rollout that turned non-finite.
    """
    rows: list[list[Cell]] = []
    for predictor, of in figures.items():
        for step in steps:
            there = {name for name, end in zip(starts.names, starts.steps, strict=True)
                     if end >= step}  # fmt: skip
            row: list[Cell] = [predictor.replace("_", " "), step, step * time_step, len(there)]
            for name, _, scale in _COLUMNS:
                value = scale * float(of[name][step - 1]) if name in of else float("nan")
                # Not a number is what was not measured; what blew up is infinite.
                row.append("" if value != value else value)
            rows.append(row)
    header = ("predictor", "steps", "time s", "simulations", *(title for _, title, _ in _COLUMNS))
    lines = write_table(path, header, rows).splitlines()
    models = [predictor for predictor in figures if predictor not in BESIDE]
    broken = _broken(figures, starts, models)
    with path.with_suffix(".md").open("a", encoding="utf-8") as file:
        file.writelines(f"\n{line}\n" for line in broken)
    return "\n".join([*lines[: 2 + len(steps) * len(models)], *broken])


def _broken(figures: Figures, starts: RolloutStarts, models: Sequence[str]) -> list[str]:
    return [
        f"{'The model' if model == 'model' else model.replace('_', ' ')}'s rollout of /{name} from "
        f"frame {frame} is not finite from step {step:.0f} on."
        for model in models
        for name, frame, step in zip(
            starts.names, starts.first, figures[model]["non_finite_step"].tolist(), strict=True
        )
        if step != float("inf")
    ]
