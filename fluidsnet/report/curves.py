"""Charts of curves as SVG, in the colors of the page."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from fluidsnet.report.events import Curve, finite

#: Placeholders for the page's colors, `--curve-1` and so on, which differ in light and dark.
_INK = "#010203"
_CURVES = tuple(f"#0102{number:02x}" for number in range(0x11, 0x17))
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,  # a run's name may have a $
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "grid.color"), _INK),
    **dict.fromkeys(("xtick.color", "ytick.color"), _INK),
    "legend.frameon": False,
    "font.size": 10.0,
}
_MARKERS = "os^Dv*"


@dataclass(frozen=True)
class Line:
    """A curve and its style.

    Attributes:
        label: Label in the legend.
        curve: Points (step, value).
        color: Number of the color, one for all curves of a run or model.
        points: True for rare values: a dashed line with markers.
    """

    label: str
    curve: Curve
    color: int = 0
    points: bool = False


def draw(lines: Sequence[Line], label: str, name: str) -> str:
    """Draw curves against training steps.

    Non-finite values leave a gap. The vertical axis is logarithmic for positive values over more
    than a decade, and symmetric logarithmic for values far below zero.

    Args:
        lines: Curves.
        label: Label of the vertical axis, with the unit.
        name: Prefix of the ids in the SVG, unique on the page.

    Returns:
        An ``<svg>`` element.
    """
    with matplotlib.rc_context({**_STYLE, "svg.hashsalt": name}):
        figure = Figure(figsize=(4.5, 2.9), layout="constrained")
        axes = figure.add_subplot()
        handles: list[Artist] = []
        for line in lines:
            handles += axes.plot(
                [step for step, _ in line.curve],
                [value if math.isfinite(value) else math.nan for _, value in line.curve],
                color=_CURVES[line.color % len(_CURVES)],
                linestyle="--" if line.points else "-",
                linewidth=1.5,
                # A single value makes no line.
                marker=_MARKERS[line.color % len(_MARKERS)]
                if len(line.curve) == 1 or (line.points and len(line.curve) <= 60)
                else None,
                markersize=4,
            )
        values = [value for line in lines for value in finite(line.curve)]
        if values and min(values) > 0 and max(values) > 10 * min(values):
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(_Plain())
            axes.yaxis.set_minor_formatter(_Plain(minor_thresholds=(2, 0.5)))
        elif values and min(values) < -100:
            axes.set_yscale("symlog", linthresh=1.0)
            axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xlabel("training step")
        axes.set_ylabel(label)
        axes.grid(alpha=0.2)
        axes.spines[["top", "right"]].set_visible(False)
        # matplotlib leaves out labels of lines that start with "_".
        labels = [line.label for line in lines]
        if len(lines) == 2:
            axes.legend(handles, labels, fontsize=9)
        elif len(lines) > 2:
            # Outside, as a long legend covers the curves.
            figure.set_figheight(2.9 + 0.2 * len(lines) / 2)
            figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=9)
        drawn = io.StringIO()
        figure.savefig(drawn, format="svg", transparent=True)
    return _for_page(drawn.getvalue(), name)


class _Plain(LogFormatter):
    """Tick labels without exponents; between decades only where there are few."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def _for_page(text: str, name: str) -> str:
    """Return the SVG element with unique ids and the colors of the page."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text)
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", text)
    for number, color in enumerate(_CURVES, start=1):
        text = text.replace(color, f"var(--curve-{number})")
    text = text.replace(_INK, "currentColor")
    # The page sets the size.
    return re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"', r"\1", text, count=1)
