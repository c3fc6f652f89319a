"""How runs trained, and what trained beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from fluidsnet.report.curves import Line, draw
from fluidsnet.report.document import Chart, Note, Part, Section, Table
from fluidsnet.report.events import RATE, TRAINED, Curve, finite, tags
from fluidsnet.report.grid import NONE, Grid, shown
from fluidsnet.report.run import Run
from fluidsnet.reporting.table import Cell

_ABLATION = "ablation/"
_COST = "ablation/cost/"
#: The rollouts' figure that is drawn; after it comes the number of steps.
_ROLLED = "rollout/position_error_mm/"


def training_section(runs: Sequence[Run]) -> Section:
    """Loss, skill, learning rate and, where they were measured, rollouts over the steps."""
    section = Section("Training")
    for run in runs:
        if TRAINED not in run.history.curves:
            what = TRAINED if run.history.curves else "curves of a training"
            words = (
                f"{run.name} has no {what}: fluidsnet fit logs the loss after every "
                "trainer.log_every_n_steps steps, and none of a shorter training."
            )
            section.parts.append(Note(words, missing=True))
    there = [run for run in runs if run.history.curves]
    charts = [
        _chart("Loss", "loss, in units of the target", (TRAINED, "val/loss"), there),
        _chart("Skill in validation", "skill", ("val/skill",), there),
        _chart("Learning rate", "learning rate", _rates(there), there),
        _chart("Rollouts in validation", "position error, mm", _rolled(there), there),
    ]
    section.parts += [chart for chart in charts if chart is not None]
    rows = [row for run in there for row in _rows(run, len(runs) > 1)]
    if rows:
        header = ("curve", "values", "first", "best", "at step", "last")
        caption = "The curves in numbers; best is the least, of skill the greatest."
        section.parts.append(Table("training", caption, Grid(header, tuple(rows))))
    section.parts += [
        Note(f"{run.name}: {tag} is not finite at step {step}, for the first time.")
        for run in there
        for tag, curve in run.history.curves.items()
        for step in [next((step for step, value in curve if not math.isfinite(value)), None)]
        if step is not None and tag in (TRAINED, "val/loss", "val/skill")
    ]
    return section


def ablation_section(runs: Sequence[Run]) -> Section:
    """Each model beside the twins that differ from it in one block."""
    section = Section("Ablations")
    for run in runs:
        found = tags([run.history], _ABLATION)
        # Of the many figures of the rollouts one; `rollout_metrics` has them all.
        for each in _rolled([run], f"ablation_{_ROLLED}", "/model"):
            found += tags([run.history], f"{each}/")
        if found:
            section.parts += _ablation(run, found)
        grid = run.tables.get("global_feature_permutation")
        if grid is not None:
            caption = f"Is the global feature used? {run.name} with its own and with a foreign one"
            section.parts.append(Table(f"foreign_context_{run.name}", caption, grid))
    if not section.parts:
        words = "No twin was trained beside a model, and no foreign global feature was tried."
        section.parts.append(Note(words, missing=True))
    return section


def _rates(runs: Sequence[Run]) -> tuple[str, ...]:
    # With twins a rate each, all the same.
    own = tags([run.history for run in runs], RATE)
    return tuple(tag for tag in own if tag in (RATE, f"{RATE}/model"))


def _rolled(runs: Sequence[Run], beginning: str = _ROLLED, ending: str = "") -> tuple[str, ...]:
    """The model's error after the most steps that all runs which roll out have."""
    steps = [
        {
            int(number)
            for tag in tags([run.history], beginning)
            for number in [tag.removeprefix(beginning).removesuffix(ending)]
            if number.isdigit()
        }
        for run in runs
    ]
    common = set.intersection(*(each for each in steps if each)) if any(steps) else set()
    return (f"{beginning}{max(common)}",) if common else ()


def _chart(caption: str, label: str, names: Sequence[str], runs: Sequence[Run]) -> Chart | None:
    lines = []
    for color, run in enumerate(runs):
        for tag in names:
            if tag in run.history.curves:
                words = f"{run.name}: {tag}" if len(runs) > 1 else tag
                rare = not tag.startswith("train/")
                lines.append(Line(words, run.history.curves[tag], color, rare))
    return _drawn(caption, label, lines)


def _drawn(caption: str, label: str, lines: Sequence[Line]) -> Chart | None:
    """The chart, unless there is no finite value to draw."""
    if not any(finite(line.curve) for line in lines):
        return None
    parts = [
        f"{line.label} goes from {shown(line.curve[0][1])} to {shown(line.curve[-1][1])}"
        for line in lines
    ]
    name = "".join(letter if letter.isalnum() else "-" for letter in caption.lower())
    words = f"{caption} over the training steps: {'; '.join(parts)}."
    return Chart(caption, words, draw(lines, label, name))


def _rows(run: Run, named: bool) -> list[tuple[Cell, ...]]:
    wanted = (TRAINED, "val/loss", "val/skill", "val/velocity_mse", "val/position_error_1_mm")
    rows: list[tuple[Cell, ...]] = []
    for tag in (*wanted, *_rolled([run]), *_rates([run])):
        curve = run.history.curves.get(tag, ())
        if curve:
            best = best_of(tag, curve) if not tag.startswith(RATE) else None
            step, value = best if best is not None else ("", "")
            name = f"{run.name}: {tag}" if named else tag
            rows.append((name, len(curve), curve[0][1], value, step, curve[-1][1]))
    return rows


def best_of(tag: str, curve: Curve) -> tuple[int, float] | None:
    """Step and value of the greatest skill, or of the least of anything else."""
    known = [(step, value) for step, value in curve if math.isfinite(value)]
    if not known:
        return None
    return (max if tag.endswith("skill") else min)(known, key=lambda point: point[1])


def _ablation(run: Run, found: Sequence[str]) -> list[Part]:
    """Charts of each figure, and a table of the last values and the costs."""
    figures: dict[str, dict[str, Curve]] = {}
    for tag in found:
        figure, _, who = tag.removeprefix(_ABLATION).removeprefix("ablation_").rpartition("/")
        figures.setdefault(figure, {})[who] = run.history.curves[tag]
    # The model first, its twins by their names.
    everyone = {who for curves in figures.values() for who in curves}
    models = sorted(everyone, key=lambda who: (who != "model", who))
    parts: list[Part] = []
    rows: list[tuple[Cell, ...]] = []
    for figure, curves in figures.items():
        cost = f"{_ABLATION}{figure}/".startswith(_COST)
        cells = (curves[who][-1][1] if who in curves else NONE for who in models)
        rows.append((figure if cost else f"{figure}, last", *cells))
        lines = [
            Line(who.replace("_", " "), curves[who], models.index(who), figure != "train_loss")
            for who in models
            if who in curves
        ]
        chart = None if cost else _drawn(f"{figure}, {run.name} and its twins", figure, lines)
        parts += [] if chart is None else [chart]
    # What is compared first, what it costs last.
    rows.sort(key=lambda row: str(row[0]).startswith("cost/"))
    grid = Grid((run.name, *(who.replace("_", " ") for who in models)), tuple(rows))
    caption = (
        f"{run.name} and the twins that differ in one block; a train_loss is in units of each "
        "one's own target"
    )
    return [*parts, Table(f"ablation_{run.name}", caption, grid)]
