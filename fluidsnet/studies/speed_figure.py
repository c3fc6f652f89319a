"""The figure of a speed study: time per simulated second against particles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from fluidsnet.studies.speed_row import Row


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw a line a way, both axes logarithmic; a bar says the spread.

    Args:
        rows: of the study; those without a time are left out.
        path: of the picture.
    """
    figure = Figure(figsize=(8.0, 5.5), layout="constrained")
    axes = figure.add_subplot()
    ways = list(dict.fromkeys(row.way for row in rows if row.step is not None))
    for number, way in enumerate(ways):
        mine = sorted(
            (row for row in rows if row.way == way and row.step is not None),
            key=lambda row: row.particles,
        )
        steps = [(row.step, row.time_step) for row in mine if row.step is not None]
        middle = [step[0] / each for step, each in steps]
        below = [(step[0] - step[1]) / each for step, each in steps]
        above = [(step[2] - step[0]) / each for step, each in steps]
        solver = mine[0].who != "network"
        axes.errorbar(
            [row.particles for row in mine],
            middle,
            yerr=[below, above],
            label=way,
            color="black" if solver else f"C{number % 10}",
            linestyle="--" if solver else "-",
            marker="os^Dv*xP+<>"[number % 11],
            markersize=4,
            capsize=2,
            linewidth=1.2,
        )
    axes.axhline(1.0, color="gray", linewidth=0.8)
    axes.text(
        0.99, 0.95, "real time", color="gray", ha="right", va="top",
        transform=axes.get_yaxis_transform(),
    )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("fluid particles")
    axes.set_ylabel("seconds per simulated second")
    axes.grid(which="major", alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=120)
