"""Sections on training: curves, and ablation twins trained beside a model."""

from __future__ import annotations

import math
from collections.abc import Sequence

from fluidsnet.report.curves import Line, draw
from fluidsnet.report.document import Chart, Note, Part, Section, Table
from fluidsnet.report.events import RATE, TRAINED, Curve, finite, tags
from fluidsnet.report.run import PERMUTED, Group, Run
from fluidsnet.report.tables import NONE, frame, shown
from fluidsnet.reporting.table import Cell

_ABLATION = "ablation/"
#: Tag of the rollout error that is drawn; the number of steps follows.
_ROLLED = "rollout/position_error_mm/"
_COLUMNS = ("curve", "values", "first", "best", "at step", "last")
_VALIDATED = ("val/loss", "val/skill", "val/velocity_mse", "val/position_error_1_mm")


def training_section(runs: Sequence[Run]) -> Section:
    """Draw loss, skill, learning rate and rollouts in validation against training steps."""
    section = Section("Training")
    for run in runs:
        if TRAINED not in run.history.curves:
            absent = TRAINED if run.history.curves else "curves of a training"
            text = (
                f"{run.name} has no {absent}: fluidsnet fit logs the loss after every "
                "trainer.log_every_n_steps steps, and none of a shorter training."
            )
            section.parts.append(Note(text, missing=True))
    logged = [run for run in runs if run.history.curves]
    section.parts += [
        *_chart("Loss", "loss, in units of the target", (TRAINED, "val/loss"), logged),
        *_chart("Skill in validation", "skill", ("val/skill",), logged),
        *_chart("Learning rate", "learning rate", _rates(logged), logged),
        *_chart("Rollouts in validation", "position error, mm", _rolled(logged), logged),
    ]
    rows = [row for run in logged for row in _rows(run, f"{run.name}: " if len(runs) > 1 else "")]
    if rows:
        caption = "Curves in numbers; best is the least value, of skill the greatest."
        section.parts.append(Table("training", caption, frame(_COLUMNS, rows)))
    for run in logged:
        for tag in (TRAINED, "val/loss", "val/skill"):
            curve = run.history.curves.get(tag, ())
            broken = [step for step, value in curve if not math.isfinite(value)]
            if broken:
                text = f"{run.name}: {tag} is not finite at step {broken[0]}, for the first time."
                section.parts.append(Note(text))
    return section


def ablation_section(runs: Sequence[Run], groups: Sequence[Group]) -> Section:
    """Compare each model with the ablation twins that differ from it in one block."""
    section = Section("Ablations")
    for run in runs:
        found = tags([run.history], _ABLATION)
        # One of the many rollout errors; the rollout tables have all.
        for tag in _rolled([run], f"ablation_{_ROLLED}", "/model"):
            found += tags([run.history], f"{tag}/")
        section.parts += _ablation(run, found) if found else []
        for group in groups:
            tables = group.results[run.name].tables if run.name in group.results else {}
            if PERMUTED in tables:
                caption = group.named(f"Errors of {run.name} with permuted global features", ": ")
                name = group.named(f"{PERMUTED}_{run.name}")
                section.parts.append(Table(name, caption, tables[PERMUTED]))
    if not section.parts:
        text = "No twin was trained beside a model, and no global features were permuted."
        section.parts.append(Note(text, missing=True))
    return section


def best_of(tag: str, curve: Curve) -> tuple[int, float] | None:
    """Return step and value of the greatest skill, or of the least value of another curve."""
    known = [(step, value) for step, value in curve if math.isfinite(value)]
    if not known:
        return None
    return (max if tag.endswith("skill") else min)(known, key=lambda point: point[1])


def _rates(runs: Sequence[Run]) -> list[str]:
    # Twins have the same learning rate.
    found = tags([run.history for run in runs], RATE)
    return [tag for tag in found if tag in (RATE, f"{RATE}/model")]


def _rolled(runs: Sequence[Run], prefix: str = _ROLLED, suffix: str = "") -> list[str]:
    """Return the tag of the model's error after the most steps that all runs with rollouts have."""
    steps = [
        {int(number) for number in numbers if number.isdigit()}
        for run in runs
        for numbers in [
            [tag.removeprefix(prefix).removesuffix(suffix) for tag in tags([run.history], prefix)]
        ]
    ]
    common = set.intersection(*filter(None, steps)) if any(steps) else set()
    return [f"{prefix}{max(common)}"] if common else []


def _chart(caption: str, label: str, wanted: Sequence[str], runs: Sequence[Run]) -> list[Chart]:
    lines = [
        Line(
            f"{run.name}: {tag}" if len(runs) > 1 else tag,
            run.history.curves[tag],
            color,
            not tag.startswith("train/"),
        )
        for color, run in enumerate(runs)
        for tag in wanted
        if tag in run.history.curves
    ]
    return _drawn(caption, label, lines)


def _drawn(caption: str, label: str, lines: Sequence[Line]) -> list[Chart]:
    """Draw a chart; none if no value is finite."""
    if not any(finite(line.curve) for line in lines):
        return []
    changes = "; ".join(
        f"{line.label} goes from {shown(line.curve[0][1])} to {shown(line.curve[-1][1])}"
        for line in lines
    )
    name = "".join(letter if letter.isalnum() else "-" for letter in caption.lower())
    text = f"{caption} over the training steps: {changes}."
    return [Chart(caption, text, draw(lines, label, name))]


def _rows(run: Run, prefix: str) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    for tag in (TRAINED, *_VALIDATED, *_rolled([run]), *_rates([run])):
        curve = run.history.curves.get(tag, ())
        if curve:
            best = None if tag.startswith(RATE) else best_of(tag, curve)
            step, value = best or ("", "")
            rows.append([prefix + tag, len(curve), curve[0][1], value, step, curve[-1][1]])
    return rows


def _ablation(run: Run, found: Sequence[str]) -> list[Part]:
    """Draw each figure, and build a table of the last values and the costs."""
    figures: dict[str, dict[str, Curve]] = {}
    for tag in found:
        figure, _, model = tag.removeprefix(_ABLATION).removeprefix("ablation_").rpartition("/")
        figures.setdefault(figure, {})[model] = run.history.curves[tag]
    # The model first, then its twins by name.
    names = {name for curves in figures.values() for name in curves}
    models = sorted(names, key=lambda name: (name != "model", name))
    labels = [name.replace("_", " ") for name in models]
    parts: list[Part] = []
    rows: list[list[Cell]] = []
    costs: list[list[Cell]] = []
    for figure, curves in figures.items():
        cells = [curves[name][-1][1] if name in curves else NONE for name in models]
        if figure.startswith("cost/"):
            costs.append([figure, *cells])
            continue
        rows.append([f"{figure}, last", *cells])
        lines = [
            Line(label, curves[name], color, figure != "train_loss")
            for color, (name, label) in enumerate(zip(models, labels, strict=True))
            if name in curves
        ]
        parts += _drawn(f"{figure}, {run.name} and its twins", figure, lines)
    caption = (
        f"{run.name} and its twins, which differ in one block; each train_loss is in units of the "
        "model's own target"
    )
    table = frame((run.name, *labels), rows + costs)
    return [*parts, Table(f"ablation_{run.name}", caption, table)]
