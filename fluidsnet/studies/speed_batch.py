"""Many frames predicted at once, beside the paper's Table 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fluidsnet.reporting.table import Cell, markdown
from fluidsnet.studies.paper_tables import batches
from fluidsnet.studies.speed_number import number
from fluidsnet.studies.speed_row import Spread


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
        others: cores that others kept busy meanwhile, or while the solver ran.
    """

    particles: int
    frames: int
    seconds: Spread
    batches: list[int]
    peak: int
    solver: float | None
    others: float = 0.0

    @property
    def way(self) -> str:
        """What follows the particles where it is named."""
        return f"× {self.frames} frames at once"


def table_3(measured: Sequence[Batch]) -> str:
    """What was measured and what the paper has, as Markdown."""
    rows: list[list[Cell]] = [
        [
            f"{batch.particles:,}",
            f"{batch.frames} in {'+'.join(map(str, batch.batches))}",
            number(batch.solver),
            number(batch.seconds[0]),
            number(batch.seconds[0] / batch.frames),
            f"{batch.peak / 1e6:.0f}",
            number(
                None if batch.solver is None else batch.solver * batch.frames / batch.seconds[0]
            ),
        ]
        for batch in measured
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
