"""Page and CSV file of the speed study."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from statistics import median
from typing import Any

import pandas as pd
from jinja2 import Environment

from fluidsnet.reporting.table import markdown
from fluidsnet.studies.machine import BUSY
from fluidsnet.studies.speed.figure import draw
from fluidsnet.studies.speed.measure import STAGES
from fluidsnet.studies.speed.trial import Result, Trial
from fluidsnet.whole_file import whole_file, write_whole

# Method and result of a line.
Row = tuple[Trial, Result]


@dataclass
class Report:
    """Results measured so far.

    Attributes:
        header: Machine, versions and settings, a line each.
        busy_before: Cores that other processes kept busy before the first measurement.
        rows: A method at a size each.
        batches: Measurements of the paper's Table 3.
        cores: Measurement of the processor.
        floors: By number of particles: `bytes` and `operations` of a step, and its time `step`, s.
    """

    header: list[str] = field(default_factory=list)
    busy_before: float = 0.0
    rows: list[Row] = field(default_factory=list)
    batches: list[Row] = field(default_factory=list)
    cores: Result = field(default_factory=Result)
    floors: dict[int, dict[str, float]] = field(default_factory=dict)

    @property
    def warnings(self) -> list[str]:
        """Measurements that other processes disturbed, a sentence each."""
        warnings = []
        if self.busy_before > BUSY:
            warnings.append(
                f"before the first measurement: others took {self.busy_before:.1f} cores."
            )
        if self.floors and self.cores.others > BUSY:
            warnings.append(
                f"while its cores were measured: others took {self.cores.others:.1f} cores; "
                "do not trust the floor."
            )
        measured = [*self.rows, *self.batches]
        busy = {trial.name: result.others for trial, result in measured if result.others > BUSY}
        if busy:
            warnings.append(
                f"during {len(busy)} of {len(measured)} measurements, others took up to "
                f"{max(busy.values()):.1f} cores; do not trust the times of: {'; '.join(busy)}."
            )
        return [f"the machine was busy {warning}" for warning in warnings]

    def write(self, folder: Path) -> str:
        """Write ``speed.md``, ``speed.csv`` and ``speed.png``; return the Markdown."""
        folder.mkdir(parents=True, exist_ok=True)
        table = speed_table(self.rows)
        with whole_file(folder / "speed.csv") as partial:
            table.to_csv(partial, index=False)
        table["label"] = [trial.label for trial, _ in self.rows]
        draw(table, folder / "speed.png")
        cores = self.cores.cores
        page = Environment(trim_blocks=True, keep_trailing_newline=True).from_string(
            Path(__file__).with_name("page.md").read_text(encoding="utf-8")
        )
        text = page.render(
            header=self.header,
            warnings=self.warnings,
            steps=_steps(table),
            stages=_stages(table),
            searches=_searches(table),
            cores=cores,
            failure=self.cores.failure,
            has_floor=bool(self.floors),
            floors=_floors(self.floors, cores) if self.floors and cores else "",
            batches=_batches(self.batches) if self.batches else "",
        )
        write_whole(folder / "speed.md", text)
        return text


def speed_table(rows: Sequence[Row]) -> pd.DataFrame:
    """Return a line for each row; an empty cell is NaN. The speed-up is over IISPH."""
    table = pd.DataFrame([_cells(*row) for row in rows])
    table = table.astype({"peak bytes": "Int64", "error": float, "neighbors per particle": float})
    table["speed-up"] = _speed_up(table, "IISPH")
    return table


def _cells(trial: Trial, result: Result) -> dict[str, object]:
    """Return the cells of a row by the names of ``speed.csv``."""
    network, time_step = trial.kind == "step", trial.options.time_step
    step = median(result.step) if result.step else nan
    return {
        "fluid particles": trial.particles,
        "wall particles": result.solids,
        "method": "network" if network else trial.kind,
        "neighbors": trial.neighbors if network else "",
        "precision": trial.precision if network else "",
        "torch.compile": trial.compile if network else "",
        "time step s": time_step,
        **_spread("step", result.step),
        **_spread("search alone", result.search),
        "s per simulated s": step / time_step,
        "particles per s": trial.particles / step,
        "peak bytes": result.peak,
        "error": result.error,
        "speed-up": nan,
        **{f"{stage} s": result.stages.get(stage, nan) for stage in STAGES},
        # Input, target, integrator and walls are part of no stage.
        "rest s": max(0.0, step - sum(result.stages.values())) if result.stages else nan,
        "neighbors per particle": result.edges,
        "others' cores": round(result.others, 2),
        "note": result.failure,
    }


def _spread(name: str, seconds: Sequence[float]) -> dict[str, float]:
    values = (median(seconds), min(seconds), max(seconds)) if seconds else (nan, nan, nan)
    return dict(zip((f"{name} s", f"{name} least s", f"{name} most s"), values, strict=True))


def _speed_up(
    table: pd.DataFrame, reference: str, by: str = "method", seconds: str = "s per simulated s"
) -> pd.Series[float]:
    """Return how many times as fast each line is as the line of its size with a reference `by`."""
    times = table[table[by] == reference].groupby("fluid particles")[seconds].first()
    return table["fluid particles"].map(times) / table[seconds]


def number(value: float | str | None) -> str:
    """Format a number with three digits or all before the point; – for none."""
    if isinstance(value, str):
        return value
    if value is None or pd.isna(value):
        return "–"
    text = f"{value:.3g}"
    # Numbers that are rounded up to 1,000 would get an exponent, too.
    return f"{value:,.0f}" if abs(float(text)) >= 1000 else text


def _markdown(columns: dict[str, Any]) -> str:
    """Return columns of numbers and texts as a Markdown table."""
    rows = zip(*columns.values(), strict=True)
    return markdown(list(columns), [list(map(number, row)) for row in rows])


def _steps(table: pd.DataFrame) -> str:
    measured = table["step s"].notna()
    return _markdown(
        {
            "fluid": table["fluid particles"],
            "walls": table["wall particles"].where(measured),
            "method": table["label"],
            "step ms": _milliseconds(table, "step").where(measured, table["note"]),
            "s per simulated s": table["s per simulated s"],
            "particles/s": table["particles per s"],
            "peak MB": table["peak bytes"] / 1e6,
            "error": table["error"],
            "× IISPH": table["speed-up"],
            "× DFSPH": _speed_up(table, "DFSPH"),
        }
    )


def _stages(table: pd.DataFrame) -> str:
    table = table.dropna(subset="rest s")
    stages = {stage: table[f"{stage} s"] for stage in (*STAGES, "rest")}
    return _markdown({"fluid": table["fluid particles"], "method": table["label"], **stages})


def _searches(table: pd.DataFrame) -> str:
    table = table.dropna(subset="search alone s")
    return _markdown(
        {
            "fluid": table["fluid particles"],
            "search": table["neighbors"],
            "ms": _milliseconds(table, "search alone"),
            "neighbors per particle": table["neighbors per particle"],
            "× torch-cluster": _speed_up(table, "TorchCluster", "neighbors", "search alone s"),
        }
    )


def _floors(floors: dict[int, dict[str, float]], cores: dict[str, float]) -> str:
    table = pd.DataFrame.from_dict(floors, orient="index").sort_index()
    return _markdown(
        {
            "fluid": table.index,
            "MB": table["bytes"] / 1e6,
            "ms for MB": 1000 * table["bytes"] / cores["bandwidth"],
            "Gflop": table["operations"] / 1e9,
            "ms for Gflop": 1000 * table["operations"] / cores["flops"],
            "measured ms": 1000 * table["step"],
        }
    )


def _batches(rows: Sequence[Row]) -> str:
    table = pd.DataFrame(
        {
            "fluid": trial.particles,
            "frames": f"{trial.options.batch} in {'+'.join(map(str, result.batches))}",
            "IISPH s a frame": result.solver or nan,
            "prediction s": median(result.step),
            "s a frame": median(result.step) / trial.options.batch,
            "peak MB": (result.peak or 0) / 1e6,
        }
        for trial, result in rows
    )
    return _markdown({**table, "× IISPH": table["IISPH s a frame"] / table["s a frame"]})


def _milliseconds(table: pd.DataFrame, name: str) -> pd.Series[str]:
    """Return the median of a time with least and most in brackets, ms."""
    columns = [1000 * table[f"{name}{part} s"] for part in ("", " least", " most")]
    rows = zip(*columns, strict=True)
    texts = ["{} ({} to {})".format(*map(number, times)) for times in rows]
    return pd.Series(texts, index=table.index, dtype=str)
