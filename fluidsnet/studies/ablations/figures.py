"""Figures of the ablation study, with a panel for each scene and stride."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluidsnet.reporting.rollout_curves import COLORS, TWIN_COLORS
from fluidsnet.studies.ablations.results import ACCELERATION, ENERGY, MODEL, MOTION, WITHOUT, Group

_COLORS = {
    MODEL: COLORS["model"],
    ACCELERATION: TWIN_COLORS[0],
    WITHOUT: TWIN_COLORS[1],
    "truth": COLORS["truth"],
}
_TARGET = {MODEL: "velocity target", ACCELERATION: "acceleration target"}
_GLOBAL = {MODEL: "with global feature", WITHOUT: "without global feature"}
#: Upper limit of the energy axis, in units of the truth's greatest energy.
_ENERGIES = 3.0


def draw_figures(folder: Path, groups: Sequence[Group]) -> None:
    """Draw ``target.png``, ``global_feature.png`` and ``global_feature_energy.png``.

    The first corresponds to the paper's figure 11, the third to its figure 12.

    Args:
        folder: Folder of the figures.
        groups: The runs; at least one group.
    """
    target_figure(groups).savefig(folder / "target.png")
    _figure(groups, _GLOBAL, _draw_training).savefig(folder / "global_feature.png")
    energy_figure(groups).savefig(folder / "global_feature_energy.png")


def target_figure(groups: Sequence[Group]) -> Figure:
    """Plot validation errors with both targets against the training step."""
    return _figure(groups, _TARGET, _draw_training)


def energy_figure(groups: Sequence[Group]) -> Figure:
    """Plot the kinetic energy of rollouts in motion, with and without the global feature.

    The axis ends at three times the truth's maximum; a panel's title names values beyond it.
    """
    return _figure(groups, {"truth": "truth", **_GLOBAL}, _draw_energy)


def trivial_mse(group: Group) -> float | None:
    """Return `velocity_mse` of the better trivial predictor on the validation split, m²/s².

    It follows from the model's error and skill, and is the same for all validations.
    """
    errors = pd.concat(
        [run.curve("velocity_mse", MODEL) / (1 - run.curve("skill", MODEL)) for run in group.runs]
    )
    errors = errors[np.isfinite(errors) & (errors > 0)]
    return None if errors.empty else float(errors.median())


def _figure(
    groups: Sequence[Group],
    labels: Mapping[str, str],
    draw: Callable[[Axes, Group, Mapping[str, str]], list[str]],
) -> Figure:
    """Make a figure; `draw` fills a panel and returns further lines of its title."""
    scenes = list(dict.fromkeys(group.scene for group in groups))
    strides = sorted({group.stride for group in groups})
    by_panel = {(group.scene, group.stride): group for group in groups}
    # At most 1,600 pixels wide.
    size = (min(6.5 * len(strides), 16.0), 3.8 * len(scenes) + 0.4)
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    panels = figure.subplots(len(scenes), len(strides), squeeze=False)
    legend: dict[str, Artist] = {}
    for scene, row in zip(scenes, panels, strict=True):
        for stride, axes in zip(strides, row, strict=True):
            group = by_panel.get((scene, stride))
            if group is None:
                axes.set_axis_off()
                axes.set_title(f"{scene}, stride {stride}: not trained", fontsize="medium")
                continue
            notes = draw(axes, group, labels)
            axes.set_title("\n".join([group.title, *notes]), fontsize="medium")
            axes.grid(which="major", alpha=0.3)
            legend |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    # Outside, since a legend in a panel would cover curves.
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=len(legend))
    return figure


def _draw_training(axes: Axes, group: Group, labels: Mapping[str, str]) -> list[str]:
    for name, label in labels.items():
        runs = [run.curve("velocity_mse", name) for run in group.runs]
        curves = pd.concat(runs, axis="columns").sort_index()
        # Lightning counts the first step as 0.
        curves.index += 1
        _plot(axes, curves, name, label)
    trivial = trivial_mse(group)
    if trivial is not None:
        style: dict[str, Any] = {"color": "#555555", "linestyle": "--", "linewidth": 1.2}
        axes.axhline(trivial, label="better trivial predictor", **style)
    axes.set(xlabel="training step", ylabel="validation velocity_mse, m²/s²", yscale="log")
    # Data within one decade may span no major grid line.
    axes.grid(which="minor", axis="y", alpha=0.15)
    return []


def _draw_energy(axes: Axes, group: Group, labels: Mapping[str, str]) -> list[str]:
    columns = ["time s", "seed", "predictor", ENERGY]
    table = group.tables[MOTION].reindex(columns=columns)
    greatest: dict[str, float] = {}
    notes = []
    for name, label in labels.items():
        rows = table[table["predictor"] == name].drop(columns="predictor")
        rows = rows.apply(pd.to_numeric, errors="coerce").dropna()
        curves = rows.pivot_table(ENERGY, "time s", "seed", aggfunc="first")
        _plot(axes, curves, name, label, marker="o")
        finite = rows[ENERGY][np.isfinite(rows[ENERGY])]
        greatest[name] = finite.max() if len(finite) else 0.0
        if len(finite) < len(rows):
            notes.append(f"{label}: not finite in the end")
    limit = _ENERGIES * greatest["truth"] or math.inf
    notes += [
        f"{label}: up to {greatest[name]:.3g} J/kg"
        for name, label in labels.items()
        if greatest[name] > limit
    ]
    axes.set_ylim(0, 1.08 * min(limit, max(greatest.values())) or None)
    axes.set(xlabel="time since the start, s", ylabel="kinetic energy of the rollout, J/kg")
    return notes


def _plot(axes: Axes, curves: pd.DataFrame, name: str, label: str, **style: Any) -> None:
    """Plot a thin line for each seed (column) and a thick one for their mean."""
    curves = curves.dropna(axis="columns", how="all")
    if curves.empty:
        return
    # Values that are not finite leave a gap.
    curves = curves.where(np.isfinite(curves))
    if curves.shape[1] > 1:
        axes.plot(curves.index, curves, color=_COLORS[name], linewidth=0.8, alpha=0.5)
    if len(curves) == 1:
        style["marker"] = "o"
    style |= {"color": _COLORS[name], "linewidth": 2.0, "markersize": 4, "label": label}
    axes.plot(curves.index, curves.mean(axis="columns", skipna=False), **style)
