"""The floor of a step: what its arithmetic and its bytes alone would take."""

from __future__ import annotations

from dataclasses import dataclass, field

from fluidsnet.reporting.table import Cell, markdown
from fluidsnet.studies.speed_number import number


@dataclass
class Floor:
    """What the cores can do, and what a step asks of them.

    Attributes:
        cores: bandwidth, bytes/s, and operations/s of these cores; empty where there is a note.
        others: cores that others kept busy while they were measured.
        note: why they were not.
        steps: bytes and operations of a step, and the s measured, by particles.
    """

    cores: dict[str, float] = field(default_factory=dict)
    others: float = 0.0
    note: str = ""
    steps: dict[int, dict[str, float]] = field(default_factory=dict)

    def table(self) -> str:
        """Each step beside its floor, as Markdown."""
        if not self.cores:
            return f"What these cores can do was not measured ({self.note}).\n"
        bandwidth, flops = self.cores["bandwidth"], self.cores["flops"]
        rows: list[list[Cell]] = [
            [
                f"{particles:,}",
                f"{one['bytes'] / 1e6:,.0f}",
                number(1000 * one["bytes"] / bandwidth),
                f"{one['operations'] / 1e9:.2f}",
                number(1000 * one["operations"] / flops),
                number(1000 * one["step"]),
            ]
            for particles, one in sorted(self.steps.items())
        ]
        text = (
            f"A copy moves {bandwidth / 1e9:.1f} GB/s, a product of matrices does "
            f"{flops / 1e9:.0f} Gflop/s on these threads. The layers' arithmetic and "
            "the state's bytes, each once, and no search, would take\n\n"
        )
        header = ("fluid", "MB", "ms for them", "Gflop", "ms for them", "measured ms")
        return text + markdown(header, rows)
