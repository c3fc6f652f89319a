"""Sections on training: curves, and ablation twins trained beside a model."""

from __future__ import annotations

import io
import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import matplotlib
import pandas as pd
from matplotlib import figure, ticker

from fluidsnet.report.events import RATE, TRAINED, Curve, finite
from fluidsnet.report.page import Figure, Note, Part, Table
from fluidsnet.report.run import PERMUTED, Group, Run
from fluidsnet.report.tables import NONE, shown
from fluidsnet.reporting.table import Cell

#: Tag of the rollout error that is drawn; the number of steps follows.
_ROLLED = "rollout/position_error_mm/"
_VALIDATED = ("val/loss", "val/skill", "val/velocity_mse", "val/position_error_1_mm")
_COLUMNS = ("curve", "values", "first", "best", "at step", "last")
#: Contrast of at least 3 to the light and to the dark page; the page colors the text.
_COLORS = ("#3b7ddd", "#d9622b", "#2e9e4f", "#9b5fe0", "#b07d10", "#d6408f")
_MARKERS = "os^Dv*"
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,  # a run's name may have a $
    **dict.fromkeys(("axes.edgecolor", "grid.color", "xtick.color", "ytick.color"), "#808890"),
    **dict.fromkeys(("legend.frameon", "axes.spines.top", "axes.spines.right"), False),
    **{"axes.grid": True, "grid.alpha": 0.2, "legend.fontsize": 9, "lines.markersize": 4},
}


class Line(NamedTuple):
    """A curve, its label in the legend, the number of its color, and its style.

    The curves of a run or model have one color. Rare `points` are drawn with markers.
    """

    label: str
    curve: Curve
    color: int = 0
    points: bool = False


def training(runs: Sequence[Run]) -> Iterator[Part]:
    """Yield charts of loss, skill, learning rate and validation rollouts, and their table."""
    for run in runs:
        curves = run.history.curves
        if TRAINED not in curves:
            absent = TRAINED if curves else "curves of a training"
            text = f"{run.name} has no {absent}: fluidsnet fit logs the loss after every "
            text += "trainer.log_every_n_steps steps, and none of a shorter training."
            yield Note(text, missing=True)
        for tag in (TRAINED, "val/loss", "val/skill"):
            broken = [step for step, value in curves.get(tag, ()) if not math.isfinite(value)]
            if broken:
                text = f"{tag} is not finite at step {broken[0]}, for the first time."
                yield Note(f"{run.name}: {text}")
    rates = (RATE, f"{RATE}/model")  # twins have the same
    for caption, label, tags in (
        ("Loss", "loss, in units of the target", (TRAINED, "val/loss")),
        ("Skill in validation", "skill", ("val/skill",)),
        ("Learning rate", "learning rate", rates),
        ("Rollouts in validation", "position error, mm", _rolled(runs)),
    ):
        lines = [
            Line(run.prefix + tag, run.history.curves[tag], color, tag[:6] != "train/")
            for color, run in enumerate(runs)
            for tag in tags
            if tag in run.history.curves
        ]
        yield from _chart(caption, label, lines)
    rows: list[list[Cell]] = []
    for run in runs:
        for tag in (TRAINED, *_VALIDATED, *_rolled([run]), *rates):
            if curve := run.history.curves.get(tag):
                step, value = (tag not in rates and best_of(tag, curve)) or ("", "")
                numbers = [len(curve), curve[0][1], value, step, curve[-1][1]]
                rows.append([run.prefix + tag, *numbers])
    if rows:
        caption = "Curves in numbers; best is the least value, of skill the greatest."
        yield Table("training", caption, pd.DataFrame(rows, columns=_COLUMNS, dtype=object))


def ablations(runs: Sequence[Run], groups: Sequence[Group]) -> Iterator[Part]:
    """Compare each model with the ablation twins that differ from it in one block."""
    parts: list[Part] = []
    for run in runs:
        parts += _twins(run)
        for group in groups:
            tables = group.tables(PERMUTED)
            if run.name in tables:
                caption = group.named(f"Errors of {run.name} with permuted global features", ": ")
                name = group.named(f"{PERMUTED}_{run.name}")
                parts.append(Table(name, caption, tables[run.name]))
    text = "No twin was trained beside a model, and no global features were permuted."
    yield from parts or [Note(text, missing=True)]


def best_of(tag: str, curve: Curve) -> tuple[int, float] | None:
    """Return step and value of the greatest skill, or of the least value of another curve."""
    best = max if tag.endswith("skill") else min
    return best(finite(curve), key=lambda point: point[1], default=None)


def draw(lines: Sequence[Line], label: str, name: str) -> str:
    """Draw curves against training steps as an ``<svg>`` element.

    Non-finite values leave a gap. The vertical axis is logarithmic for positive values over more
    than a decade, and symmetric logarithmic for values far below zero. The ids in the element
    start with `name`, which must be unique on a page.
    """
    with matplotlib.rc_context({**_STYLE, "svg.hashsalt": name}):
        chart = figure.Figure(figsize=(4.5, 2.9), layout="constrained")
        axes = chart.add_subplot()
        for line in lines:
            color = line.color % len(_COLORS)
            # A single value makes no line.
            marked = len(line.curve) == 1 or (line.points and len(line.curve) <= 60)
            axes.plot(
                *zip(*line.curve, strict=True),
                color=_COLORS[color],
                linestyle="--" if line.points else "-",
                marker=_MARKERS[color] if marked else None,
            )
        values = [value for line in lines for _, value in finite(line.curve)] or [0.0]
        if min(values) > 0 and max(values) > 10 * min(values):
            few = max(values) < 1000 * min(values)
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5) if few else (1,)))
            axes.yaxis.set_minor_formatter(ticker.NullFormatter())
            axes.yaxis.set_major_formatter("{x:g}")
        elif min(values) < -100:
            axes.set_yscale("symlog", linthresh=1.0)
            axes.yaxis.set_major_formatter("{x:g}")
        axes.set(xlabel="training step", ylabel=label)
        if len(lines) > 1:
            # Outside, as a long legend covers the curves; labels may start with "_".
            chart.set_figheight(2.9 + 0.1 * len(lines))
            labels = [line.label for line in lines]
            chart.legend(axes.lines, labels, loc="outside lower center", ncols=2)
        drawn = io.StringIO()
        no_metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        chart.savefig(drawn, format="svg", transparent=True, metadata=no_metadata)
    svg = drawn.getvalue()
    return re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", svg[svg.index("<svg") :])


def _chart(caption: str, label: str, lines: Sequence[Line]) -> Iterator[Part]:
    """Yield a chart; none if no value is finite."""
    if any(finite(line.curve) for line in lines):
        changes = "; ".join(
            f"{line.label} goes from {shown(line.curve[0][1])} to {shown(line.curve[-1][1])}"
            for line in lines
        )
        svg = draw(lines, label, re.sub(r"\W", "-", caption.lower()))
        yield Figure(caption, f"{caption} over the training steps: {changes}.", svg)


def _rolled(runs: Sequence[Run], prefix: str = _ROLLED, suffix: str = "") -> list[str]:
    """Return the tag of the model's error after the most steps that all runs with rollouts have."""
    pattern = re.compile(rf"{prefix}(\d+){suffix}")
    found = [[pattern.fullmatch(tag) for tag in run.history.curves] for run in runs]
    steps = [{int(match[1]) for match in matches if match} for matches in found]
    common = set.intersection(*filter(None, steps)) if any(steps) else set[int]()
    return [f"{prefix}{max(common)}{suffix}"] if common else []


def _twins(run: Run) -> Iterator[Part]:
    """Yield a chart of each figure, and a table of the last values and the costs."""
    # One of the many rollout errors; the rollout tables have all.
    rolled = [tag.removesuffix("model") for tag in _rolled([run], f"ablation_{_ROLLED}", "/model")]
    figures: dict[str, dict[str, Curve]] = defaultdict(dict)
    for tag, curve in sorted(run.history.curves.items()):
        if tag.startswith(("ablation/", *rolled)):
            name, _, model = re.sub("^ablation[_/]", "", tag).rpartition("/")
            figures[name][model] = curve
    if not figures:
        return
    # The model first, then its twins by name.
    models = sorted(set[str]().union(*figures.values()), key=lambda name: (name != "model", name))
    labels = [name.replace("_", " ") for name in models]
    rows: list[list[Cell]] = []
    for name, curves in figures.items():
        cost = name.startswith("cost/")
        cells = [curves[model][-1][1] if model in curves else NONE for model in models]
        rows.append([name if cost else f"{name}, last", *cells])
        lines = [
            Line(label, curves[model], color, name != "train_loss")
            for color, (model, label) in enumerate(zip(models, labels, strict=True))
            if model in curves and not cost
        ]
        yield from _chart(f"{name}, {run.name} and its twins", name, lines)
    caption = (
        f"{run.name} and its twins, which differ in one block; each train_loss is in units of the "
        "model's own target"
    )
    rows.sort(key=lambda row: str(row[0]).startswith("cost/"))
    table = pd.DataFrame(rows, columns=[run.name, *labels], dtype=object)
    yield Table(f"ablation_{run.name}", caption, table)
