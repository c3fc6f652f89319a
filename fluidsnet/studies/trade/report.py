"""Tables of the trade study."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from fluidsnet.reporting.table import Cell, markdown, write_csv
from fluidsnet.studies.trade.fronts import sentences
from fluidsnet.studies.trade.options import TradeOptions
from fluidsnet.studies.trade.rows import Row, floor, planes, useless
from fluidsnet.whole_file import write_whole

#: File with the rows, for `fluidsnet trade recommend`.
ROWS = "trade.json"
#: Frames after which errors from true states are printed.
NEAR = (1, 2, 4, 8)
#: Header, result and factor of what is printed of a rollout at its last mark.
_FAR = (
    ("misplaced %", "misplaced", 100.0),
    ("chamfer mm", "chamfer_mm", 1.0),
    ("energy %", "energy_error", 100.0),
    ("density %", "density_error", 100.0),
    ("escaped %", "escaped", 100.0),
    ("non-finite %", "non_finite", 100.0),
)

EXPLANATION = (
    "CPU and wall time are for a second of fluid, from true states: means over the frames of a "
    "simulation, medians over simulations; set-up and training are apart. Memory is the most "
    "beyond that before the set-up. Errors and skill (of velocities; 1 is perfect, 0 as good as "
    "the better trivial predictor) are after that many frames from true states; rollouts start at "
    "the first frame. The share of the volume that is misplaced, the chamfer distance, the error "
    "of the kinetic energy over all frames so far, the excess density, and the shares of "
    "particles outside the walls or not finite are those of the last mark of a rollout. Means "
    "over the simulations, with the least and the greatest behind the first error and the last "
    "rollout. The floor is the solver of the data itself, with a start that is moved by a "
    "thousandth of a radius, or with half its step: an error below it means nothing. A time with "
    "a star was measured while other processes took part of a core."
)


def write_report(
    folder: Path, notes: Sequence[str], options: TradeOptions, rows: Sequence[Row]
) -> tuple[str, list[str]]:
    """Write trade.md, trade.csv and trade.json.

    Args:
        folder: Folder of the study.
        notes: Lines above the table.
        options: What was measured.
        rows: Points with their results.

    Returns:
        The table in Markdown, and the sentences on what speed costs.
    """
    _write_values(folder / "trade.csv", rows)
    values = [asdict(row) for row in rows]
    write_whole(folder / ROWS, json.dumps({"rows": values, "marks": options.marks}, indent=1))
    near = [frame for frame in NEAR if frame <= options.horizon]
    marks = sorted(options.marks)
    header = (
        *("point", "CPU s/s", "wall s/s", "set-up s", "training s", "MB"),
        *(f"error {frame} mm" for frame in near),
        *(f"skill {frame}" for frame in near[:2]),
        *(f"rollout {mark} m" for mark in marks),
        *(title for title, _, _ in _FAR),
    )
    table = markdown(header, [_cells(row, near, marks) for row in rows])
    failures = [
        f"- {row.label} failed in {simulation}: {reason}"
        for row in rows
        for simulation, reason in row.failed.items()
    ]
    told = answers(options, rows)
    blocks = ["# Error against cost", *notes, *told, table, EXPLANATION]
    if failures:
        blocks += ["## Failed", "\n".join(failures)]
    write_whole(folder / "trade.md", "\n\n".join(blocks) + "\n")
    return table, told


def answers(options: TradeOptions, rows: Sequence[Row]) -> list[str]:
    """Return the sentences on what speed costs, from true states and at two marks of a rollout."""
    interval = rows[0].interval if rows else 0.0
    marks = sorted(options.marks)
    seconds = options.horizon * interval
    places = [("error_mm", options.horizon, f"{1000 * seconds:g} ms after true states")]
    places += [
        ("rollout_mm", mark, f"{mark * interval:g} s into a rollout")
        for mark in dict.fromkeys((marks[len(marks) // 2], marks[-1]))
    ]
    told = []
    for result, frames, when in places:
        points, chaos = planes(rows, result, frames), floor(rows, result, frames)
        told += sentences(points, when)
        if left := useless(rows, result, frames):
            told.append(
                f"{when}, these err no less than a trivial predictor, which costs nothing, and are "
                f"left out: {', '.join(left)}."
            )
        near = [
            label
            for kind, plane in points.items()
            for label, (_, error) in plane.items()
            if kind != "solver" and error < 1.2 * chaos
        ]
        if near:
            told.append(
                f"{when}, the floor of chaos is {chaos:.3g} mm, and {len(near)} points err less "
                "than a fifth more than that: they cannot be told apart."
            )
    return told


def _write_values(path: Path, rows: Sequence[Row]) -> None:
    cells: list[list[Cell]] = []
    for row in rows:
        for simulation, it in row.measured.items():
            costs = {
                "wall_s": it.wall,
                "cpu_s": it.cpu,
                "setup_s": it.setup,
                "memory_mb": it.memory,
            }
            values = {**it.values, **{name: {1: value} for name, value in costs.items()}}
            cells += [
                [row.label, row.kind, simulation, it.fluid, result, frames, value]
                for result, by_frames in values.items()
                for frames, value in by_frames.items()
            ]
        for simulation, reason in row.failed.items():
            cells.append([row.label, row.kind, simulation, "", "failed", "", reason])
    header = ("point", "kind", "simulation", "fluid particles", "result", "frames", "value")
    write_csv(path, header, cells)


def _cells(row: Row, near: list[int], marks: list[int]) -> list[Cell]:
    if not row.measured:
        count = 5 + len(near) + len(near[:2]) + len(marks) + len(_FAR)
        return [f"{row.label} (failed)", *[""] * count]
    star = "*" if row.spoiled else ""
    training: Cell = "" if math.isnan(row.training) else row.training
    cells: list[Cell] = [row.label, f"{row.cpu:.3g}{star}", f"{row.wall:.3g}{star}"]
    cells += [row.setup, training, "" if math.isnan(row.memory) else row.memory]
    cells += [_mean(row, "error_mm", frame, spread=frame == near[0]) for frame in near]
    cells += [_mean(row, "skill", frame) for frame in near[:2]]
    cells += [_mean(row, "rollout_mm", mark, 1e-3, spread=mark == marks[-1]) for mark in marks]
    return cells + [_mean(row, result, marks[-1], factor) for _, result, factor in _FAR]


def _mean(row: Row, result: str, frames: int, factor: float = 1.0, spread: bool = False) -> Cell:
    """Return the mean over simulations; empty where none has a value."""
    values = [factor * value for value in row.values(result, frames)]
    if not values:
        return ""
    mean = factor * row.mean(result, frames)
    return f"{mean:.3g} ({min(values):.2g}-{max(values):.2g})" if spread else mean
