"""Curves of rollout metrics against time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from fluidsnet.baselines import TRIVIAL_PREDICTORS, Baselines
from fluidsnet.metrics.suite import RolloutResults
from fluidsnet.whole_file import whole_file

#: Colors of the predictors.
COLORS = {
    "model": "#1f63ea",
    "integrator_floor": "#888888",
    "constant_velocity": "#e08214",
    "ballistic": "#b2182b",
    "truth": "#111111",
}
#: Colors of the twins, in their order.
TWIN_COLORS = ("#2a9d3a", "#8e44ad", "#d6409f", "#0e9aa7")
_TRIVIAL = tuple(TRIVIAL_PREDICTORS)
# Name of the metric, label of the axis, predictors, and True for a logarithmic axis.
_Panel = tuple[str, str, tuple[str, ...], bool]
_PANELS: tuple[_Panel, ...] = (
    ("position_error_mm", "position error, mm", ("model", *Baselines.names), True),
    ("kinetic_energy_j_per_kg", "kinetic energy, J/kg", ("truth", "model", *_TRIVIAL), False),
    ("center_of_mass", "center of mass, relative error", ("model", *_TRIVIAL), True),
)


def draw_curves(
    path: Path, results: RolloutResults, time_step: float, loggers: Sequence[Any], group: str
) -> None:
    """Draw error, energy and center of mass against time to a PNG file and to TensorBoard.

    Non-finite values have no line; the title of the panel has the time they begin at.

    Args:
        path: Path of the picture.
        results: Metrics of the rollouts.
        time_step: s.
        loggers: Loggers of the trainer; those of TensorBoard get the panels.
        group: Group of the tags in TensorBoard.
    """
    pictures = [_picture(panel, results, time_step) for panel in _PANELS]
    with whole_file(path) as partial:
        Image.fromarray(np.hstack(pictures)).save(partial, format="PNG")
    for logger in loggers:
        if isinstance(logger, TensorBoardLogger):
            # One picture per panel, as TensorBoard shows pictures small.
            for panel, picture in zip(_PANELS, pictures, strict=True):
                tag = f"{group}/{panel[0]}"
                logger.experiment.add_image(tag, picture, dataformats="HWC")


def _picture(panel: _Panel, results: RolloutResults, time_step: float) -> NDArray[np.uint8]:
    """Return one panel as a picture (height, width, 3)."""
    figure = Figure(figsize=(5.2, 4.2), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    _draw(figure.subplots(), panel, results, time_step)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]


def _draw(axes: Axes, panel: _Panel, results: RolloutResults, time_step: float) -> None:
    name, label, predictors, logarithmic = panel
    twins = [predictor for predictor in results if predictor not in COLORS]
    colors = {**COLORS, **dict(zip(twins, cycle(TWIN_COLORS)))}
    broken: list[str] = []
    for predictor in (*predictors, *twins):
        values = results[predictor][name].cpu().numpy()
        time = time_step * np.arange(1, len(values) + 1)
        # A logarithmic axis cannot show an integrator floor of zero.
        drawn = np.where(np.isfinite(values) & ((values > 0) | (not logarithmic)), values, np.nan)
        axes.plot(
            time,
            drawn,
            color=colors[predictor],
            label=predictor.replace("_", " "),
            marker="." if len(values) == 1 else None,
        )
        if predictor in ("model", *twins) and np.isinf(values).any():
            broken.append(f"{predictor} not finite from {time[np.isinf(values).argmax()]:g} s on")
    axes.set_title("\n".join(broken))
    axes.set(xlabel="time, s", ylabel=label, yscale="log" if logarithmic else "linear")
    if not logarithmic:
        shown = ("truth", "model", *twins)
        axes.set_ylim(0, _top([results[predictor][name].cpu().numpy() for predictor in shown]))
    axes.grid(alpha=0.3)
    axes.legend()


def _top(curves: Sequence[NDArray[Any]]) -> float:
    """Return the upper end of the axis for curves; ballistic falls on and may leave the axis."""
    values = np.concatenate(curves)
    values = values[np.isfinite(values)]
    return 1.3 * float(values.max(initial=1e-3))
