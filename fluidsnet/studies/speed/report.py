"""Page, CSV file and figure of the speed study."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import pandas as pd
from matplotlib.figure import Figure

from fluidsnet.reporting.table import markdown
from fluidsnet.studies.machine import BUSY
from fluidsnet.studies.speed import paper
from fluidsnet.studies.speed.floor import Floor
from fluidsnet.studies.speed.table import Row, number, speed_table, speed_up
from fluidsnet.studies.speed.trial import STAGES


@dataclass
class Report:
    """Results measured so far.

    Attributes:
        header: Machine, versions and settings, a line each.
        busy_before: Cores that other processes kept busy before the first measurement.
        rows: A method at a size each.
        batches: Measurements of the paper's Table 3.
        floor: Lower bounds on the time of a step.
    """

    header: list[str] = field(default_factory=list)
    busy_before: float = 0.0
    rows: list[Row] = field(default_factory=list)
    batches: list[Row] = field(default_factory=list)
    floor: Floor = field(default_factory=Floor)

    @property
    def warnings(self) -> list[str]:
        """Measurements that other processes disturbed, a sentence each."""
        warnings = []
        if self.busy_before > BUSY:
            warnings.append(
                f"the machine was busy before the first measurement: others took "
                f"{self.busy_before:.1f} cores."
            )
        if self.floor.steps and self.floor.others > BUSY:
            warnings.append(
                f"the machine was busy while its cores were measured: others took "
                f"{self.floor.others:.1f} cores; do not trust the floor."
            )
        measured = [*self.rows, *self.batches]
        busy = [row for row in measured if row.others > BUSY]
        if busy:
            names = "; ".join(row.name for row in busy)
            warnings.append(
                f"the machine was busy during {len(busy)} of {len(measured)} measurements, "
                f"others took up to {max(row.others for row in busy):.1f} cores; do not trust "
                f"the times of: {names}."
            )
        return warnings

    def write(self, folder: Path) -> str:
        """Write ``speed.md``, ``speed.csv`` and ``speed.png``; return the Markdown."""
        folder.mkdir(parents=True, exist_ok=True)
        table = speed_table(self.rows)
        table.to_csv(folder / "speed.csv", index=False)
        table["label"] = [row.label for row in self.rows]
        draw(table, folder / "speed.png")
        parts = ["# Speed\n", *(f"- {line}" for line in self.header)]
        parts += [f"\n**Warning: {line}**" for line in self.warnings]
        parts += [
            "\nThese times do not depend on the weights: a network steps as fast with random "
            "weights, so they say nothing about accuracy.\n",
            "## A step, and a simulated second\n",
            "Median of the repeats; least and most in brackets.\n",
            _steps(table),
            "\n## Where a step's time goes, s\n",
            "Medians of three steps under torch's profiler. `search + local` is one pass that "
            "stores no edges, and `sort` puts the particles into its cells; other methods first "
            "search and store the edges (`search`), then compute the feature (`local`). `rest` is "
            "the time of a step without the profiler less the sum of the stages.\n",
            _stages(table),
            "\n## The search alone, its edges stored\n",
            _searches(table),
        ]
        if self.floor.steps:
            parts += ["\n## The floor\n", self.floor.page()]
        if self.batches:
            parts += [
                "\n## Many frames at once, beside the paper's Table 3\n",
                "Measured here on dam breaks with as many particles. The frames are known and each "
                "is stepped once. A rollout gains nothing from it, since each of its frames needs "
                "the one before.\n",
                _batches(self.batches),
                paper.table_3(),
            ]
        parts += ["\n## Large scenes: the paper's Table 4, for comparison\n", paper.table_4()]
        text = "\n".join(parts)
        (folder / "speed.md").write_text(text)
        return text


def draw(table: pd.DataFrame, path: Path) -> None:
    """Draw the time per simulated second against the number of particles, a line a method.

    Args:
        table: As of `speed_table`, with the column `label`; lines without a time are left out.
        path: Path of the picture.
    """
    measured = table.dropna(subset="step s")
    if measured.empty:
        return
    figure = Figure(figsize=(8.0, 5.5), layout="constrained")
    axes = figure.add_subplot()
    for index, (_, lines) in enumerate(measured.groupby("label", sort=False)):
        lines = lines.sort_values("fluid particles")
        middle, least, most = (
            lines[f"step{part} s"] / lines["time step s"] for part in ("", " least", " most")
        )
        solver = lines["method"].iloc[0] != "network"
        axes.errorbar(
            lines["fluid particles"],
            middle,
            yerr=[middle - least, most - middle],
            label=lines["label"].iloc[0],
            color="black" if solver else f"C{index % 10}",
            linestyle="--" if solver else "-",
            marker="os^Dv*xP+<>"[index % 11],
            markersize=4,
            capsize=2,
            linewidth=1.2,
        )
    axes.axhline(1.0, color="gray", linewidth=0.8)
    axes.text(
        0.99, 0.95, "real time", color="gray", ha="right", va="top",
        transform=axes.get_yaxis_transform(),
    )  # fmt: skip
    axes.set(
        xscale="log", yscale="log", xlabel="fluid particles", ylabel="seconds per simulated second"
    )
    axes.grid(which="major", alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=120)


def _steps(table: pd.DataFrame) -> str:
    measured = table["step s"].notna()
    return _markdown(
        {
            "fluid": table["fluid particles"].map("{:,}".format),
            "walls": table["wall particles"].map("{:,}".format).where(measured, ""),
            "method": table["label"],
            "step ms": _milliseconds(table, "step").where(measured, table["note"]),
            "s per simulated s": table["s per simulated s"].map(number),
            "particles/s": table["particles per s"].map(lambda value: number(value, ",.0f")),
            "peak MB": (table["peak bytes"] / 1e6).map(lambda value: number(value, ".0f")),
            "error": table["error"].map(lambda value: number(value, ".1e")),
            "× IISPH": table["speed-up"].map(number),
            "× DFSPH": speed_up(table, "DFSPH").map(number),
        }
    )


def _stages(table: pd.DataFrame) -> str:
    table = table.dropna(subset="rest s")
    return _markdown(
        {
            "fluid": table["fluid particles"].map("{:,}".format),
            "method": table["label"],
            **{stage: table[f"{stage} s"].map(number) for stage in (*STAGES, "rest")},
        }
    )


def _searches(table: pd.DataFrame) -> str:
    table = table.dropna(subset="search alone s")
    ratio = speed_up(table, "TorchCluster", by="neighbors", seconds="search alone s")
    return _markdown(
        {
            "fluid": table["fluid particles"].map("{:,}".format),
            "search": table["neighbors"],
            "ms": _milliseconds(table, "search alone"),
            "neighbors per particle": table["neighbors per particle"].map(number),
            "× torch-cluster": ratio.map(number),
        }
    )


def _batches(rows: Sequence[Row]) -> str:
    cells = []
    for row in rows:
        seconds, solver = median(row.result.step), row.solver
        cells.append(
            [
                f"{row.particles:,}",
                f"{row.frames} in {'+'.join(map(str, row.result.batches))}",
                number(solver),
                number(seconds),
                number(seconds / row.frames),
                number((row.result.peak or 0) / 1e6, ".0f"),
                number(None if solver is None else solver * row.frames / seconds),
            ]
        )
    header = (
        "fluid", "frames", "IISPH s a frame", "prediction s", "s a frame", "peak MB", "× IISPH"
    )  # fmt: skip
    return markdown(header, cells)


def _milliseconds(table: pd.DataFrame, name: str) -> pd.Series[str]:
    """Return the median of a time with least and most in brackets, ms."""
    columns = (table[f"{name}{part} s"] for part in ("", " least", " most"))
    texts = [
        "{} ({} to {})".format(*(number(1000 * seconds) for seconds in times))
        for times in zip(*columns, strict=True)
    ]
    return pd.Series(texts, index=table.index, dtype=str)


def _markdown(columns: dict[str, Sequence[str] | pd.Series[str]]) -> str:
    return markdown(list(columns), list(zip(*columns.values(), strict=True)))
