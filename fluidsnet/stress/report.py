"""Tables and pictures of the stress study."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from fluidsnet.export.render import Panel, side_by_side
from fluidsnet.particles import Particles
from fluidsnet.reporting.table import Cell, markdown, write_csv
from fluidsnet.stress.outcome import Outcome
from fluidsnet.whole_file import whole_file, write_whole

HEADER = (
    "case", "by", "verdict", "steps", "speed / bound", "energy rise %", "escaped %", "density %",
    "momentum %", "angular %", "in use",
)  # fmt: skip

EXPLANATION = (
    "*Steps* are those with finite states, of those asked for. *Speed / bound* is the highest "
    "speed over that of free fall through the box, √(v₀² + 2gh). *Energy rise* is the highest "
    "total energy less that of the start, over the latter and that of a fall by a radius. "
    "*Escaped* is the share outside the box at the end, less that of the start. *Density* is the "
    "highest 99.9th percentile of the excess density after the first tenth. The drifts of "
    "momentum and angular momentum are relative to those of the parts at the start, where no "
    "force acts from outside. *In use* is what `fluidsnet test` and `predict` say of such a scene: "
    "they refuse it, warn, or say nothing; here it is stepped all the same. *Stable*: finite, none "
    "escaped, energy at most 1 % above its start, speed at most three times the bound, which "
    "jets of the solver reach, excess density at most 20 %. *Blows up*: not finite, energy twice "
    "that of the start, six times the bound, or half of the particles outside. *Degrades*: between "
    "the two."
)

_VERDICTS = ("stable", "degrades", "blows up", "fails")

#: Outcomes by case and by who made them: "model", "prior" or "solver".
Outcomes = Mapping[str, Mapping[str, Outcome]]
#: Title, columns and rows of a further table.
Table = tuple[str, Sequence[str], Sequence[Sequence[Cell]]]


def write_report(
    folder: Path, notes: Sequence[str], outcomes: Outcomes, tables: Sequence[Table]
) -> str:
    """Write stress.md, stress.csv and the pictures; return the text.

    Args:
        folder: Folder of the results; it is made.
        notes: Lines above the tables.
        outcomes: Outcomes of the cases.
        tables: Further tables.
    """
    rows = [_cells(case, by, it) for case, made in outcomes.items() for by, it in made.items()]
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "stress.csv", HEADER, rows)
    verdicts = [made["model"].verdict for made in outcomes.values()]
    counts = ", ".join(f"{verdicts.count(name)} {name}" for name in _VERDICTS if name in verdicts)
    blocks = ["# Stress", *notes, f"{len(verdicts)} cases: {counts}.", markdown(HEADER, rows)]
    reasons = [
        f"- {case}, {by}: {it.reason}"
        for case, made in outcomes.items()
        for by, it in made.items()
        if it.reason
    ]
    if reasons:
        blocks += ["Failures:", "\n".join(reasons)]
    for title, columns, values in tables:
        blocks += [f"## {title}", markdown(columns, values)]
    blocks.append(EXPLANATION)
    text = "\n\n".join(blocks) + "\n"
    write_whole(folder / "stress.md", text)
    _draw(folder / "stress.png", outcomes)
    return text


def draw_failure(path: Path, case: str, start: Particles, outcome: Outcome) -> None:
    """Draw the start and the last finite state of a case.

    Args:
        path: PNG file.
        case: Name of the case.
        start: Start state.
        outcome: Its outcome, with the last state.
    """
    assert outcome.last is not None
    scene = start.scene
    lower, upper = scene.domain_lower[0].numpy(), scene.domain_upper[0].numpy()
    shown = []
    for title, state in (
        (f"{case}: start", start),
        (f"after {outcome.survived} steps: {outcome.verdict}", outcome.last),
    ):
        # Particles far outside would make the picture a speck.
        place = state.position.clamp(scene.domain_lower - 0.5, scene.domain_upper + 0.5)
        shown.append(Panel(title, place.numpy(), state.velocity.norm(dim=1).numpy()))
    gravity = scene.gravity[0].tolist()
    side_by_side(path, shown, lower, upper, scene.particle_radius, gravity=gravity)


def _cells(case: str, by: str, it: Outcome) -> list[Cell]:
    numbers: list[Cell] = [
        "" if math.isnan(value) else value
        for value in (
            it.speed, 100 * it.energy_rise, 100 * it.escaped, 100 * it.density,
            100 * it.momentum, 100 * it.angular,
        )
    ]  # fmt: skip
    steps = f"{it.survived}" if it.survived == it.steps else f"{it.survived} of {it.steps}"
    return [case, by, it.verdict, steps, *numbers, it.at_use.partition(":")[0]]


def _draw(path: Path, outcomes: Outcomes) -> None:
    """Draw the total energy of each case over that of its start; gray where it is stable."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    for case, made in outcomes.items():
        it = made["model"]
        if len(it.course) < 2:
            continue
        total = [kinetic + potential for _, kinetic, potential, _ in it.course]
        scale = max(abs(total[0]), 1e-30)
        steps = [max(step, 0.5) for step, *_ in it.course]
        values = [min(max(value / scale, 1e-3), 1e3) for value in total]
        if it.verdict == "stable":
            axes.plot(steps, values, color="lightgray", linewidth=1, zorder=1)
        else:
            axes.plot(steps, values, linewidth=1, label=f"{case}: {it.verdict}")
    axes.set(xscale="log", yscale="log", xlabel="step")
    axes.set_ylabel("total energy over that of the start")
    axes.axhline(1.0, color="black", linewidth=0.5, linestyle=":")
    axes.grid(alpha=0.25)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.01, 0.5))
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=110)
