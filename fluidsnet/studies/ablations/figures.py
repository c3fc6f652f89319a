"""The figures of the ablation study, a panel a scene and stride."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import fmean, median

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluidsnet.reporting.rollout_curves import COLORS, TWIN_COLORS
from fluidsnet.studies.ablations.group import Group
from fluidsnet.studies.ablations.numbers import ACCELERATION, MODEL, MOTION, WITHOUT

_COLORS = {
    MODEL: COLORS["model"],
    ACCELERATION: TWIN_COLORS[0],
    WITHOUT: TWIN_COLORS[1],
    "truth": COLORS["truth"],
}
_TARGET = {MODEL: "velocity target", ACCELERATION: "acceleration target"}
_CONTEXT = {MODEL: "with global feature", WITHOUT: "without global feature"}
_Draw = Callable[[Axes, Group, Mapping[str, str]], list[str]]
#: A curve: (training step or time, value).
Points = Sequence[tuple[float, float]]
_ENERGY = "kinetic_energy J/kg"
#: How many times the truth's greatest energy an axis shows at most.
_ENERGIES = 3.0


def draw_figures(folder: Path, groups: Sequence[Group]) -> None:
    """Draw ``target.png``, ``global_feature.png`` and ``global_feature_energy.png``.

    The first corresponds to the paper's figure 11: both models' `velocity_mse` on the validation
    split against the training step. The second is the same with and without the global feature;
    the third is what figure 12 shows, in numbers.

    Args:
        folder: that they are written into.
        groups: the runs; one at least.
    """
    drawn = {
        "target.png": target_figure(groups),
        "global_feature.png": context_figure(groups),
        "global_feature_energy.png": energy_figure(groups),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in drawn.items():
        figure.savefig(folder / name)


def target_figure(groups: Sequence[Group]) -> Figure:
    """Errors with either target while training."""
    return _figure(groups, _TARGET, _training)


def context_figure(groups: Sequence[Group]) -> Figure:
    """Errors with and without the global feature while training."""
    return _figure(groups, _CONTEXT, _training)


def energy_figure(groups: Sequence[Group]) -> Figure:
    """Kinetic energy of rollouts in motion, with and without the global feature, and the truth's.

    A panel's title says what is beyond its axis, which ends at three times the truth's most.
    """
    return _figure(groups, {"truth": "truth", **_CONTEXT}, _energy)


def trivial_mse(group: Group) -> float | None:
    """`velocity_mse` of the better trivial predictor on the validation split, m²/s².

    The frames are the same for all models and validations, and skill is measured against it.
    """
    found = []
    for run in group.runs:
        skills = dict(run.curve("skill", MODEL))
        for step, error in run.curve("velocity_mse", MODEL):
            rest = 1 - skills.get(step, math.nan)
            if math.isfinite(error) and math.isfinite(rest) and rest > 0:
                found.append(error / rest)
    return median(found) if found else None


def mean_curve(curves: Sequence[Points]) -> Points:
    """The mean of curves, where all have a value."""
    known = [dict(curve) for curve in curves if curve]
    if not known:
        return ()
    steps = sorted(set.intersection(*map(set, known)))
    return [(step, fmean(curve[step] for curve in known)) for step in steps]


def _figure(groups: Sequence[Group], who: Mapping[str, str], draw: _Draw) -> Figure:
    scenes = list(dict.fromkeys(group.scene for group in groups))
    strides = sorted({group.stride for group in groups})
    known = {(group.scene, group.stride): group for group in groups}
    # 1,600 pixels at most.
    size = (min(6.5 * len(strides), 16.0), 3.8 * len(scenes) + 0.4)
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    panels = figure.subplots(len(scenes), len(strides), squeeze=False)
    legend: dict[str, Artist] = {}
    for scene, row in zip(scenes, panels, strict=True):
        for stride, axes in zip(strides, row, strict=True):
            if (scene, stride) not in known:
                axes.set_axis_off()
                axes.set_title(f"{scene}, stride {stride}: not trained", fontsize="medium")
                continue
            group = known[scene, stride]
            notes = draw(axes, group, who)
            axes.set_title("\n".join([group.title, *notes]), fontsize="medium")
            axes.grid(which="major", alpha=0.3)
            legend |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    # Of curves inside a panel a legend there would cover some.
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=len(legend))
    return figure


def _training(axes: Axes, group: Group, who: Mapping[str, str]) -> list[str]:
    for name, label in who.items():
        curves = [run.curve("velocity_mse", name) for run in group.runs]
        # Lightning counts the first step as 0.
        _lines(axes, [[(step + 1, value) for step, value in one] for one in curves], name, label)
    trivial = trivial_mse(group)
    if trivial is not None:
        axes.axhline(
            trivial,
            color="#555555",
            linestyle="--",
            linewidth=1.2,
            label="better trivial predictor",
        )
    axes.set(xlabel="training step", ylabel="validation velocity_mse, m²/s²", yscale="log")
    # Within a decade there may be no line between two powers of ten.
    axes.grid(which="minor", axis="y", alpha=0.15)
    return []


def _energy(axes: Axes, group: Group, who: Mapping[str, str]) -> list[str]:
    most, notes = {}, []
    for name, label in who.items():
        curves: list[Points] = []
        for run in group.runs:
            found = (
                (time, run.rollout(name, steps, _ENERGY, MOTION))
                for steps, time in run.times(MOTION).items()
            )
            curves.append([(time, value) for time, value in found if value is not None])
        _lines(axes, curves, name, label, marker="o")
        values = [value for curve in curves for _, value in curve]
        most[name] = max(filter(math.isfinite, values), default=0.0)
        if not all(map(math.isfinite, values)):
            notes.append(f"{label}: not finite in the end")
    limit = _ENERGIES * most["truth"] or math.inf
    beyond = [name for name in who if most[name] > limit]
    notes += [f"{who[name]}: up to {most[name]:.3g} J/kg" for name in beyond]
    axes.set_ylim(0, 1.08 * min(limit, max(most.values())) or None)
    axes.set(xlabel="time since the start, s", ylabel="kinetic energy of the rollout, J/kg")
    return notes


def _lines(
    axes: Axes, curves: Sequence[Points], name: str, label: str, marker: str | None = None
) -> None:
    """A thin line a seed, and a thick one for their mean."""
    known = [curve for curve in curves if curve]
    if not known:
        return
    color = _COLORS[name]
    for curve in known if len(known) > 1 else ():
        axes.plot(*_finite(curve), color=color, linewidth=0.8, alpha=0.5)
    middle = mean_curve(known)
    if len(middle) == 1:
        marker = "o"
    axes.plot(
        *_finite(middle), color=color, linewidth=2.0, marker=marker, markersize=4, label=label
    )


def _finite(curve: Points) -> tuple[list[float], list[float]]:
    """What is drawn: a gap where a value is not finite."""
    values = [value if math.isfinite(value) else math.nan for _, value in curve]
    return [where for where, _ in curve], values
