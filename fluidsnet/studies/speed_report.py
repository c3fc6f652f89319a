"""The tables of a speed study, as Markdown and CSV."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path

from fluidsnet.reporting.table import Cell, markdown
from fluidsnet.studies.machine import BUSY
from fluidsnet.studies.paper_tables import large_scenes
from fluidsnet.studies.speed_batch import Batch, table_3
from fluidsnet.studies.speed_floor import Floor
from fluidsnet.studies.speed_number import NONE, milliseconds, number
from fluidsnet.studies.speed_row import Row, speed_up
from fluidsnet.studies.trial import STAGES


@dataclass
class Report:
    """All that a study has measured so far.

    Attributes:
        header: what it was measured on and how, a line each.
        busy_before: cores that others took before the first measurement.
        rows: a size and a way each.
        batches: the paper's Table 3.
        floor: what the cores can do, and what a step asks of them.
    """

    header: list[str] = field(default_factory=list)
    busy_before: float = 0.0
    rows: list[Row] = field(default_factory=list)
    batches: list[Batch] = field(default_factory=list)
    floor: Floor = field(default_factory=Floor)

    def solver(self, row: Row, name: str = "IISPH") -> Row | None:
        """The solver's row of the same size."""
        same = (one for one in self.rows if one.who == name and one.particles == row.particles)
        return next(same, None)

    @property
    def warnings(self) -> list[str]:
        """What may have spoiled the times."""
        found = []
        if self.busy_before > BUSY:
            found.append(
                f"the machine was busy before the first measurement: others took "
                f"{self.busy_before:.1f} cores."
            )
        if self.floor.steps and self.floor.others > BUSY:
            found.append(
                f"the machine was busy while its cores were measured: others took "
                f"{self.floor.others:.1f} cores; do not trust the floor."
            )
        measured: list[Row | Batch] = [*self.rows, *self.batches]
        busy = [one for one in measured if one.others > BUSY]
        if busy:
            names = "; ".join(f"{one.particles:,} {one.way}" for one in busy)
            found.append(
                f"the machine was busy during {len(busy)} of {len(measured)} measurements, "
                f"others took up to {max(one.others for one in busy):.1f} cores; do not trust "
                f"the times of: {names}."
            )
        return found

    def write(self, folder: Path) -> str:
        """Writes ``speed.md`` and ``speed.csv``; returns the Markdown."""
        folder.mkdir(parents=True, exist_ok=True)
        lines = [row.csv(self.solver(row)) for row in self.rows]
        if lines:
            with (folder / "speed.csv").open("w", newline="") as file:
                writer = csv.DictWriter(file, list(lines[0]))
                writer.writeheader()
                writer.writerows(lines)
        parts = ["# Speed\n", *(f"- {line}" for line in self.header)]
        parts += [f"\n**Warning: {line}**" for line in self.warnings]
        parts += [
            "\nSpeed says nothing of accuracy: a network steps as fast with random weights.\n",
            "## A step, and a simulated second\n",
            "Median of the repeats, the least and the most in brackets.\n",
            self._steps(),
            "\n## Where a step's time goes, s\n",
            "Medians of three steps under torch's profiler. `search + local` is one pass that "
            "stores no edge, `sort` puts particles into its cells; the others search first and "
            "store the edges. `rest` is the unprofiled step less the stages.\n",
            self._stages(),
            "\n## The search alone, its edges stored\n",
            self._searches(),
        ]
        if self.floor.steps:
            parts += ["\n## The floor\n", self.floor.table()]
        if self.batches:
            heading = "\n## Many frames at once, beside the paper's Table 3\n"
            parts += [heading, table_3(self.batches)]
        parts += ["\n## Large scenes: the paper's Table 4, for comparison\n", large_scenes()]
        text = "\n".join(parts)
        (folder / "speed.md").write_text(text)
        return text

    def _steps(self) -> str:
        header = (
            "fluid", "walls", "method", "step ms", "s per simulated s", "particles/s",
            "peak MB", "error", "× IISPH", "× DFSPH",
        )  # fmt: skip
        rows: list[list[Cell]] = []
        for row in self.rows:
            if row.step is None:
                rows.append([f"{row.particles:,}", "", row.way, row.note, *6 * [NONE]])
                continue
            rows.append(
                [
                    f"{row.particles:,}",
                    f"{row.solids:,}",
                    row.way,
                    milliseconds(row.step),
                    number(row.per_simulated_second),
                    f"{row.particles_per_second:,.0f}",
                    number(None if row.peak is None else row.peak / 1e6, ".0f"),
                    number(row.error, ".1e"),
                    number(speed_up(row, self.solver(row))),
                    number(speed_up(row, self.solver(row, "DFSPH"))),
                ]
            )
        return markdown(header, rows)

    def _stages(self) -> str:
        rows: list[list[Cell]] = [
            [
                f"{row.particles:,}",
                row.way,
                *(number(row.stages.get(stage)) for stage in STAGES),
                number(row.rest),
            ]
            for row in self.rows
            if row.stages
        ]
        return markdown(("fluid", "method", *STAGES, "rest"), rows)

    def _searches(self) -> str:
        found = [row for row in self.rows if row.search is not None]
        cluster = {
            row.particles: row.search[0]
            for row in found
            if row.search is not None and row.neighbors == "TorchCluster"
        }
        rows: list[list[Cell]] = []
        for row in found:
            assert row.search is not None
            other = cluster.get(row.particles)
            rows.append(
                [
                    f"{row.particles:,}",
                    row.neighbors,
                    milliseconds(row.search),
                    number(row.edges),
                    number(None if other is None else other / row.search[0]),
                ]
            )
        header = (
            "fluid",
            "search",
            "ms",
            "neighbors per particle",
            "× torch-cluster",
        )
        return markdown(header, rows)
