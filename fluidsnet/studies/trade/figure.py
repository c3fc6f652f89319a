"""Figure of the trade study: error against cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from fluidsnet.studies.trade.measure import Measured

#: Color and marker of each kind of point.
_LOOKS = {"solver": ("black", "s"), "prior alone": ("C0", "o"), "network": ("C3", "^")}


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
    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    panels = (
        ("error_mm", frames, 1.0, f"error {frames} frames from true states, mm"),
        ("rollout_mm", mark, 1e-3, f"error of a rollout after {mark} frames, m"),
    )
    for axes, (result, after, factor, title) in zip(figure.subplots(1, 2), panels, strict=True):
        named = set()
        for label, measured in shown.items():
            cost = 1000 * fmean(it.cpu for it in measured)
            errors = [factor * it.values[result].get(after, math.nan) for it in measured]
            if not all(map(math.isfinite, errors)):
                continue
            kind = kinds[label]
            color, marker = _LOOKS[kind]
            mean = fmean(errors)
            axes.errorbar(
                [cost],
                [mean],
                yerr=[[mean - min(errors)], [max(errors) - mean]],
                color=color,
                marker=marker,
                markersize=5,
                capsize=2,
                linewidth=1,
                linestyle="",
                label=None if kind in named else kind,
            )
            named.add(kind)
            axes.annotate(
                label, (cost, mean), (5, 3), textcoords="offset points", fontsize=7, color=color
            )
        axes.set(xscale="log", yscale="log", xlabel="CPU ms a frame", ylabel=title)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
        axes.margins(x=0.15)
        axes.grid(which="both", alpha=0.25)
        axes.legend(fontsize="small")
    figure.savefig(path, dpi=120)
