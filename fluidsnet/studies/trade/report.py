"""Tables of the trade study."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

from fluidsnet.reporting.table import Cell, markdown, write_csv
from fluidsnet.studies.trade.measure import Measured
from fluidsnet.studies.trade.options import TradeOptions

#: Frames after which errors from true states are printed.
NEAR = (1, 2, 4, 8)
#: Header, result and factor of what is printed of a rollout at its last mark.
_FAR = (
    ("chamfer mm", "chamfer_mm", 1.0),
    ("energy %", "energy_error", 100.0),
    ("escaped %", "escaped", 100.0),
    ("non-finite %", "non_finite", 100.0),
)

#: Results of a point by simulation.
Results = dict[str, Measured]


def write_report(
    folder: Path, notes: Sequence[str], options: TradeOptions, results: dict[str, Results]
) -> None:
    """Write trade.md and trade.csv.

    Args:
        folder: Folder of the study.
        notes: Lines above the table.
        options: What was measured.
        results: Results by the label of a point.
    """
    rows: list[list[Cell]] = [
        [label, simulation, it.fluid, result, frames, value]
        for label, measured in results.items()
        for simulation, it in measured.items()
        for result, values in {**it.values, "wall_s": {1: it.wall}, "cpu_s": {1: it.cpu}}.items()
        for frames, value in values.items()
    ]
    header = ("point", "simulation", "fluid particles", "result", "frames", "value")
    write_csv(folder / "trade.csv", header, rows)
    near = [frame for frame in NEAR if frame <= options.horizon]
    marks = sorted(options.marks)
    table = markdown(
        (
            *("point", "wall ms", "CPU ms"),
            *(f"error {frame} mm" for frame in near),
            *(f"skill {frame}" for frame in near[:2]),
            *(f"rollout {mark} m" for mark in marks),
            *(title for title, _, _ in _FAR),
        ),
        [_row(label, list(it.values()), near, marks) for label, it in results.items()],
    )
    text = "\n\n".join(["# Error against cost", *notes, _EXPLANATION, table])
    (folder / "trade.md").write_text(text, encoding="utf-8")


_EXPLANATION = (
    "Times are means for the interval of a frame, from true states. Errors and skill (of "
    "velocities; 1 is perfect, 0 as good as the better trivial predictor) are after that many "
    "frames from true states; rollouts start at the first frame. The chamfer distance, the error "
    "of the kinetic energy over all frames so far, and the shares of particles outside the walls "
    "or not finite are those of the last mark of a rollout. Means over the simulations, with the "
    "least and the greatest behind the first error and the last rollout."
)


def _row(label: str, measured: list[Measured], near: list[int], marks: list[int]) -> list[Cell]:
    cells: list[Cell] = [label]
    cells += [1000 * fmean(getattr(it, name) for it in measured) for name in ("wall", "cpu")]
    cells += [_mean(measured, "error_mm", frame, spread=frame == near[0]) for frame in near]
    cells += [_mean(measured, "skill", frame) for frame in near[:2]]
    cells += [_mean(measured, "rollout_mm", mark, 1e-3, spread=mark == marks[-1]) for mark in marks]
    return cells + [_mean(measured, result, marks[-1], factor) for _, result, factor in _FAR]


def _mean(
    measured: list[Measured], result: str, frames: int, factor: float = 1.0, spread: bool = False
) -> Cell:
    """Return the mean over simulations; empty where none has a value."""
    values = [factor * it.values[result].get(frames, math.nan) for it in measured]
    values = [value for value in values if not math.isnan(value)]
    if not values:
        return ""
    mean = fmean(values)
    return f"{mean:.3g} ({min(values):.2g}-{max(values):.2g})" if spread else mean
