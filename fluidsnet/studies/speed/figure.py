"""Figure of the speed study."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from fluidsnet.whole_file import whole_file


def draw(table: pd.DataFrame, path: Path) -> None:
    """Draw the time per simulated second against the number of particles, a line a label."""
    measured = table.dropna(subset="step s")
    if measured.empty:
        return
    figure = Figure(figsize=(8.0, 5.5), layout="constrained")
    axes = figure.add_subplot()
    for index, (label, lines) in enumerate(measured.groupby("label", sort=False)):
        middle, least, most = (
            lines[f"step{part} s"] / lines["time step s"] for part in ("", " least", " most")
        )
        solver = lines["method"].iloc[0] != "network"
        axes.errorbar(
            lines["fluid particles"],
            middle,
            yerr=[middle - least, most - middle],
            label=str(label),
            color="black" if solver else f"C{index}",
            linestyle="--" if solver else "-",
            marker="os^Dv*xP+<>"[index % 11],
            markersize=4,
            capsize=2,
            linewidth=1.2,
        )
    axes.axhline(1.0, color="gray", linewidth=0.8, label="real time")
    axes.set(
        xscale="log", yscale="log", xlabel="fluid particles", ylabel="seconds per simulated second"
    )
    axes.grid(which="major", alpha=0.3)
    axes.legend(fontsize="small")
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=120)
