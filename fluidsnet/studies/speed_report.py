"""The tables of a speed study, as Markdown and CSV."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path

from callbacks.table import Cell, markdown
from fluidsnet.studies.machine import BUSY
from fluidsnet.studies.paper_tables import batches, large_scenes
from fluidsnet.studies.speed_row import Row, Spread, speed_up
from fluidsnet.studies.trial import STAGES

_NONE = "–"


@dataclass
class Batch:
    """Many frames predicted at once.

    Attributes:
        particles: of the fluid in a frame.
        frames: predicted.
        seconds: of all frames.
        batches: frames in each batch.
        peak: bytes.
        solver: s of the solver's frame.
    """

    particles: int
    frames: int
    seconds: Spread
    batches: list[int]
    peak: int
    solver: float | None


@dataclass
class Report:
    """All that a study has measured so far.

    Attributes:
        header: what it was measured on and how, a line each.
        busy_before: cores that others took before the first measurement.
        rows: a size and a way each.
        batches: the paper's Table 3.
        floors: bytes and operations of a step, and the least s they take, by particles.
        cores: bandwidth, bytes/s, and operations/s of these cores.
    """

    header: list[str] = field(default_factory=list)
    busy_before: float = 0.0
    rows: list[Row] = field(default_factory=list)
    batches: list[Batch] = field(default_factory=list)
    floors: dict[int, dict[str, float]] = field(default_factory=dict)
    cores: dict[str, float] = field(default_factory=dict)

    def solver(self, row: Row, name: str = "IISPH") -> Row | None:
        """The solver's row of the same size."""
        same = (one for one in self.rows if one.who == name and one.particles == row.particles)
        return next(same, None)

    @property
    def warnings(self) -> list[str]:
        """What may have spoilt the times."""
        found = []
        if self.busy_before > BUSY:
            found.append(
                f"the machine was busy before the first measurement: others took "
                f"{self.busy_before:.1f} cores."
            )
        busy = [row for row in self.rows if row.others > BUSY]
        if busy:
            names = "; ".join(f"{row.particles:,} {row.way}" for row in busy)
            found.append(
                f"the machine was busy during {len(busy)} of {len(self.rows)} measurements, "
                f"others took up to {max(row.others for row in busy):.1f} cores; do not trust "
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
        if self.floors:
            parts += ["\n## The floor\n", self._floor()]
        if self.batches:
            parts += ["\n## Many frames at once, beside the paper's Table 3\n", self._table_3()]
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
                rows.append([f"{row.particles:,}", "", row.way, row.note, *6 * [_NONE]])
                continue
            rows.append(
                [
                    f"{row.particles:,}",
                    f"{row.solids:,}",
                    row.way,
                    _ms(row.step),
                    _number(row.per_simulated_second),
                    f"{row.particles_per_second:,.0f}",
                    _number(None if row.peak is None else row.peak / 1e6, ".0f"),
                    _number(row.error, ".1e"),
                    _number(speed_up(row, self.solver(row))),
                    _number(speed_up(row, self.solver(row, "DFSPH"))),
                ]
            )
        return markdown(header, rows)

    def _stages(self) -> str:
        rows: list[list[Cell]] = [
            [
                f"{row.particles:,}",
                row.way,
                *(_number(row.stages.get(stage)) for stage in STAGES),
                _number(row.rest),
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
                    _ms(row.search),
                    _number(row.edges),
                    _number(None if other is None else other / row.search[0]),
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

    def _floor(self) -> str:
        rows: list[list[Cell]] = []
        for particles, one in sorted(self.floors.items()):
            rows.append(
                [
                    f"{particles:,}",
                    f"{one['bytes'] / 1e6:,.0f}",
                    _number(1000 * one["bytes"] / self.cores["bandwidth"]),
                    f"{one['operations'] / 1e9:.2f}",
                    _number(1000 * one["operations"] / self.cores["flops"]),
                    _number(1000 * one["step"]),
                ]
            )
        text = (
            f"A copy moves {self.cores['bandwidth'] / 1e9:.1f} GB/s, a product of matrices does "
            f"{self.cores['flops'] / 1e9:.0f} Gflop/s on these threads. The layers' arithmetic and "
            "the state's bytes, each once, and no search, would take\n\n"
        )
        header = ("fluid", "MB", "ms for them", "Gflop", "ms for them", "measured ms")
        return text + markdown(header, rows)

    def _table_3(self) -> str:
        rows: list[list[Cell]] = [
            [
                f"{batch.particles:,}",
                f"{batch.frames} in {'+'.join(map(str, batch.batches))}",
                _number(batch.solver),
                _number(batch.seconds[0]),
                _number(batch.seconds[0] / batch.frames),
                f"{batch.peak / 1e6:.0f}",
                _number(
                    None if batch.solver is None else batch.solver * batch.frames / batch.seconds[0]
                ),
            ]
            for batch in self.batches
        ]
        header = (
            "fluid", "frames", "IISPH s a frame", "prediction s", "s a frame", "peak MB", "× IISPH"
        )  # fmt: skip
        return (
            "Measured here: dam breaks of as many particles. The frames are known ones, each "
            "stepped once; a rollout's frames wait for each other and gain nothing.\n\n"
            + markdown(header, rows)
            + "\n"
            + batches()
        )


def _ms(values: Spread) -> str:
    middle, least, most = (_number(1000 * value) for value in values)
    return f"{middle} ({least} to {most})"


def _number(value: float | None, form: str = ".3g") -> str:
    if value is None:
        return _NONE
    return f"{value:,.0f}" if form == ".3g" and abs(value) >= 1000 else f"{value:{form}}"
