"""Figure of the trade study: error against cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from fluidsnet.studies.trade.measure import Measured

#: Color and marker of each kind of point.
_LOOKS = {"solver": ("black", "s"), "prior alone": ("C0", "o"), "network": ("C3", "^")}
_POINT: dict[str, Any] = {"markersize": 5, "capsize": 2, "linewidth": 1}
_NUMBER: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8}


def draw(
    path: Path,
    kinds: Mapping[str, str],
    results: Mapping[str, Mapping[str, Measured]],
    frames: int,
    mark: int,
) -> None:
    """Draw the errors from true states and of rollouts against CPU time.

    Args:
        path: File to write.
        kinds: Kind of each point by its label; others than those of the legend are left out.
        results: Results by label and simulation.
        frames: Frames after which errors from true states are drawn.
        mark: Frames after which those of rollouts are drawn.
    """
    shown = {label: list(it.values()) for label, it in results.items() if kinds[label] in _LOOKS}
    if not shown:
        return
    figure = Figure(figsize=(12.0, 5.0), layout="constrained")
    left, right, names = figure.subplots(1, 3, width_ratios=(4, 4, 2))
    panels = (
        (left, "error_mm", frames, 1.0, f"error {frames} frames from true states, mm"),
        (right, "rollout_mm", mark, 1e-3, f"error of a rollout after {mark} frames, m"),
    )
    for number, (label, measured) in enumerate(shown.items(), start=1):
        color, marker = _LOOKS[kinds[label]]
        cost = 1000 * fmean(it.cpu for it in measured)
        for axes, result, after, factor, _ in panels:
            errors = [factor * it.values[result].get(after, math.nan) for it in measured]
            if not all(map(math.isfinite, errors)):
                continue
            mean = fmean(errors)
            spread = [[mean - min(errors)], [max(errors) - mean]]
            axes.errorbar([cost], [mean], yerr=spread, color=color, marker=marker, **_POINT)
            axes.annotate(str(number), (cost, mean), (5, 3), color=color, **_NUMBER)
        place = (0.0, 1.0 - number / (len(shown) + 1))
        names.annotate(f"{number}  {label}", place, color=color, fontsize=8)
    names.set_axis_off()
    for axes, _, _, _, title in panels:
        axes.set(xscale="log", yscale="log", xlabel="CPU ms a frame", ylabel=title)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
        axes.grid(which="both", alpha=0.25)
    present = {kind: look for kind, look in _LOOKS.items() if kind in map(kinds.get, shown)}
    handles = [Line2D([], [], color=color, marker=it, ls="") for color, it in present.values()]
    left.legend(handles, present, fontsize="small")
    figure.savefig(path, dpi=120)
