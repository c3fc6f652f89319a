"""One line of the table of speeds: one size, one way to step it."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import median

from fluidsnet.studies.trial import STAGES

#: How wide the spread is said: the least and the most of all repeats.
Spread = tuple[float, float, float]


def spread(seconds: list[float]) -> Spread:
    """Median, least and most."""
    return median(seconds), min(seconds), max(seconds)


@dataclass
class Row:
    """What was measured of one way at one size; None where there is nothing.

    Attributes:
        particles: of the fluid.
        solids: of the walls.
        who: `network`, or the solver's name.
        neighbors: the network's search.
        precision: the network's.
        compiled: whether torch.compile had its turn.
        time_step: s that a step simulates.
        step: s of a step, or of the solver's frame of as many seconds.
        peak: bytes of a step beyond the loaded model and state.
        error: mean |Δv| against float32 in plain torch, over its root mean square.
        search: s of the search alone with its edges stored.
        stages: s of each stage, medians under the profiler.
        edges: neighbors of a particle, on average.
        others: cores that others kept busy meanwhile.
        note: why there is nothing.
    """

    particles: int
    solids: int
    who: str
    neighbors: str = ""
    precision: str = ""
    compiled: bool = False
    time_step: float = 0.02
    step: Spread | None = None
    peak: int | None = None
    error: float | None = None
    search: Spread | None = None
    stages: dict[str, float] = field(default_factory=dict)
    edges: float | None = None
    others: float = 0.0
    note: str = ""

    @property
    def way(self) -> str:
        """What is compared from size to size."""
        if self.who != "network":
            return self.who
        more = [self.precision, *(["torch.compile"] if self.compiled else [])]
        return ", ".join([self.neighbors, *more])

    @property
    def per_simulated_second(self) -> float | None:
        """S of wall time for a simulated second."""
        return None if self.step is None else self.step[0] / self.time_step

    @property
    def particles_per_second(self) -> float | None:
        """Fluid particles stepped in a second of wall time."""
        return None if self.step is None else self.particles / self.step[0]

    @property
    def rest(self) -> float | None:
        """S of a step that no stage has: the inputs, the target, the integrator, the walls."""
        if self.step is None or not self.stages:
            return None
        return max(0.0, self.step[0] - sum(self.stages.values()))

    def csv(self, solver: Row | None) -> dict[str, object]:
        """The row by column; speed-up over a solver's row of the same size."""
        columns: dict[str, object] = {
            "fluid particles": self.particles,
            "wall particles": self.solids,
            "method": self.who,
            "neighbors": self.neighbors,
            "precision": self.precision,
            "torch.compile": self.compiled if self.who == "network" else "",
            "time step s": self.time_step,
        }
        for name, values in (("step", self.step), ("search alone", self.search)):
            for part, label in enumerate(("", " least", " most")):
                columns[f"{name}{label} s"] = None if values is None else values[part]
        columns["s per simulated s"] = self.per_simulated_second
        columns["particles per s"] = self.particles_per_second
        columns["peak bytes"] = self.peak
        columns["error"] = self.error
        columns["speed-up"] = speed_up(self, solver)
        for stage in STAGES:
            columns[f"{stage} s"] = self.stages.get(stage)
        columns["rest s"] = self.rest
        columns["neighbors per particle"] = self.edges
        columns["others' cores"] = round(self.others, 2)
        columns["note"] = self.note
        return {name: "" if value is None else value for name, value in columns.items()}


def speed_up(row: Row, solver: Row | None) -> float | None:
    """The solver's seconds per simulated second over a row's."""
    if solver is None or solver.per_simulated_second is None or row.per_simulated_second is None:
        return None
    return solver.per_simulated_second / row.per_simulated_second
