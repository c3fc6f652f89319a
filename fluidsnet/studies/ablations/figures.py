"""Figures of the ablation study, with a panel for each scene and stride."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluidsnet.reporting.rollout_curves import COLORS, TWIN_COLORS
from fluidsnet.studies.ablations.results import ACCELERATION, ENERGY, MODEL, MOTION, WITHOUT, Group

_COLORS = {**COLORS, ACCELERATION: TWIN_COLORS[0], WITHOUT: TWIN_COLORS[1]}
_TARGET = {MODEL: "velocity target", ACCELERATION: "acceleration target"}
_GLOBAL = {MODEL: "with global feature", WITHOUT: "without global feature"}
#: Upper limit of the energy axis, in units of the truth's greatest energy.
_ENERGIES = 3.0


def draw_figures(groups: Sequence[Group]) -> dict[str, Figure]:
    """Draw the figures, by name; needs at least one group.

    `target` and `global_feature` are validation errors against the training step (paper, figure
    11). `global_feature_energy` is the kinetic energy of rollouts in motion (figure 12). Its axis
    ends at three times the truth's maximum; a panel's title names values beyond it.
    """
    return {
        "target": _figure(groups, _TARGET, _draw_training),
        "global_feature": _figure(groups, _GLOBAL, _draw_training),
        "global_feature_energy": _figure(groups, {"truth": "truth", **_GLOBAL}, _draw_energy),
    }


def trivial_mse(group: Group) -> float | None:
    """Return `velocity_mse` of the better trivial predictor on the validation split, m²/s².

    It follows from the model's error and skill, and is the same for all validations.
    """
    curves = zip(group.curves("velocity_mse"), group.curves("skill"), strict=True)
    errors = pd.concat([error / (1 - skill) for error, skill in curves])
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
    panels = figure.subplots(len(scenes), len(strides), squeeze=False).flat
    legend: dict[str, Artist] = {}
    for (scene, stride), axes in zip(product(scenes, strides), panels, strict=True):
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
        curves = pd.concat(group.curves("velocity_mse", name), axis="columns").sort_index()
        # Lightning counts the first step as 0.
        curves.index += 1
        _plot(axes, curves, name, label)
    if (trivial := trivial_mse(group)) is not None:
        axes.axhline(
            trivial, label="better trivial predictor", color="#555555", ls="--", linewidth=1.2
        )
    axes.set(xlabel="training step", ylabel="validation velocity_mse, m²/s²", yscale="log")
    # Data within one decade may span no major grid line.
    axes.grid(which="minor", axis="y", alpha=0.15)
    return []


def _draw_energy(axes: Axes, group: Group, labels: Mapping[str, str]) -> list[str]:
    greatest: dict[str, float] = {}
    notes = []
    for name, label in labels.items():
        rows = group.select(MOTION, ENERGY, name).dropna(subset="value")
        curves = rows.pivot_table("value", "time", "seed", aggfunc="first")
        _plot(axes, curves, name, label, marker="o")
        finite = rows["value"][np.isfinite(rows["value"])]
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
