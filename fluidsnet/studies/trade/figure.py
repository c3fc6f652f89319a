"""Figure of the trade study: error against cost, as a picture and for a page."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from html import escape
from io import StringIO
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from fluidsnet.studies.trade.fronts import pareto
from fluidsnet.studies.trade.options import TradeOptions
from fluidsnet.studies.trade.rows import Row, floor

#: Color and marker of each kind of point.
_LOOKS = {"solver": ("black", "s"), "prior alone": ("C0", "o"), "network": ("C3", "^")}
_POINT: dict[str, Any] = {"markersize": 5, "linewidth": 1}
_NUMBER: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8}
#: Prefix of the names of drawn points in the SVG.
_NAME = "point-"


def draw(options: TradeOptions, rows: Sequence[Row]) -> Figure | None:
    """Draw the errors from true states and of rollouts against CPU time, with the fronts.

    Args:
        options: What was measured.
        rows: Points; trivial predictors are left out, and the floor of chaos is a line.

    Returns:
        The figure; None if there is no point to draw.
    """
    shown = [row for row in rows if row.kind in _LOOKS and row.measured]
    if not shown:
        return None
    marks = sorted(options.marks)
    panels = (
        ("error_mm", _shared(shown, options.horizon), 1.0, "error {} ms from true states, mm"),
        ("rollout_mm", marks[len(marks) // 2], 1.0, "error {} ms from the start, mm"),
        ("misplaced", marks[-1], 100.0, "volume elsewhere {} ms from the start, %"),
    )
    figure = Figure(figsize=(16.0, 5.0), layout="constrained")
    *axes, names = figure.subplots(1, len(panels) + 1, width_ratios=(4, 4, 4, 3))
    interval = shown[0].interval
    for place, (result, frames, factor, title) in zip(axes, panels, strict=True):
        _panel(place, shown, result, frames, factor)
        place.set_ylabel(title.format(f"{1000 * frames * interval:g}"))
        chaos = factor * floor(rows, result, frames)
        if math.isfinite(chaos) and chaos > 0:
            place.axhline(chaos, color="gray", linestyle=":", linewidth=1)
    for number, row in enumerate(shown, start=1):
        where = (0.0, 1.0 - number / (len(shown) + 1))
        names.annotate(f"{number}  {row.label}", where, color=_LOOKS[row.kind][0], fontsize=8)
    names.set_axis_off()
    kinds = [kind for kind in _LOOKS if kind in {row.kind for row in shown}]
    handles = [
        Line2D([], [], color=_LOOKS[kind][0], marker=_LOOKS[kind][1], linewidth=0.7)
        for kind in kinds
    ]
    labels = [*kinds]
    if any(row.kind == "floor" for row in rows):
        handles.append(Line2D([], [], color="gray", linestyle=":"))
        labels.append("floor of chaos")
    axes[0].legend(handles, labels, fontsize="small")
    return figure


def hoverable(figure: Figure, rows: Sequence[Row]) -> str:
    """Return a figure of `draw` as SVG whose points tell their name and numbers."""
    text = StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "fluidsnet"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    shown = [row for row in rows if row.kind in _LOOKS and row.measured]

    def told(found: re.Match[str]) -> str:
        row, result, frames = shown[int(found[2])], found[3], int(found[4])
        error = row.mean(result, frames)
        measured = f"{100 * error:.3g} %" if result == "misplaced" else f"{error:.3g} mm"
        title = f"{row.label}: {measured}; {row.cpu:.3g} CPU s, {row.wall:.3g} s for a second"
        return f"{found[1]}<title>{escape(title)}</title>"

    svg = re.sub(rf'(<g id="{_NAME}(\d+)-(\w+)-(\d+)">)', told, text.getvalue())
    return svg[svg.index("<svg") :]


def _panel(axes: Axes, shown: Sequence[Row], result: str, frames: int, factor: float) -> None:
    drawn_planes: dict[str, dict[str, tuple[float, float]]] = {}
    for number, row in enumerate(shown):
        color, marker = _LOOKS[row.kind]
        cost, error = row.cpu, factor * row.mean(result, frames)
        if not math.isfinite(error):
            continue
        values = [factor * value for value in row.values(result, frames)]
        drawn_planes.setdefault(row.kind, {})[row.label] = (cost, error)
        axes.plot([cost, cost], [min(values), max(values)], color=color, linewidth=1)
        (drawn,) = axes.plot([cost], [error], color=color, marker=marker, **_POINT)
        drawn.set_gid(f"{_NAME}{number}-{result}-{frames}")
        axes.annotate(str(number + 1), (cost, error), (5, 3), color=color, **_NUMBER)
    for kind, plane in drawn_planes.items():
        front = [plane[label] for label in pareto(plane)]
        axes.plot(*zip(*front, strict=True), color=_LOOKS[kind][0], linewidth=0.7, zorder=1)
    axes.set(xscale="log", yscale="log", xlabel="CPU s for a second of fluid")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    axes.grid(which="both", alpha=0.25)


def _shared(rows: Sequence[Row], horizon: int) -> int:
    """Return the frames, up to the horizon, after which most points have a state, or fewest."""
    counts = {
        frames: sum(bool(row.values("error_mm", frames)) for row in rows)
        for frames in range(1, horizon + 1)
    }
    return max(counts, key=lambda frames: (counts[frames], -frames))
