"""Curves as SVG that takes its colors from the page around it."""

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

#: Stand for the page's colors; the page gives `--curve-1` and so on, for light and dark.
_INK = "#010203"
_CURVES = tuple(f"#0102{number:02x}" for number in range(0x11, 0x17))
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,  # a run's name may have a $
    "text.color": _INK,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "grid.color": _INK,
    "legend.frameon": False,
    "font.size": 10.0,
}
_MARKERS = "os^Dv*"


@dataclass(frozen=True)
class Line:
    """A curve and how it is drawn.

    Attributes:
        label: in the legend.
        curve: (step, value).
        color: number of the color, the same for all curves of a run or model.
        points: whether each value is marked and the line dashed, as of what is measured rarely.
    """

    label: str
    curve: Curve
    color: int = 0
    points: bool = False


def draw(lines: Sequence[Line], label: str, name: str) -> str:
    """Draw curves over the training steps.

    Values that are not finite leave a gap. The axis is logarithmic where all values are above
    zero and spread over more than a decade, and linear about zero and logarithmic beyond one
    where they reach far below.

    Args:
        lines: the curves.
        label: of the vertical axis, with the unit.
        name: of no other drawing on the page, for the names in the SVG.

    Returns:
        an ``<svg>`` element.
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
                # One value alone makes no line.
                marker=_MARKERS[line.color % len(_MARKERS)] if _marked(line) else None,
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
        # Named here, as a curve's own label is left out where it begins with "_".
        labels = [line.label for line in lines]
        if len(lines) == 2:
            axes.legend(handles, labels, fontsize=9)
        elif len(lines) > 2:
            # They would cover the curves.
            figure.set_figheight(2.9 + 0.2 * len(lines) / 2)
            figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=9)
        drawn = io.StringIO()
        figure.savefig(drawn, format="svg", transparent=True)
    return _for_page(drawn.getvalue(), name)


class _Plain(LogFormatter):
    """Numbers without exponents; those between decades where there are few decades."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def _marked(line: Line) -> bool:
    return len(line.curve) == 1 or (line.points and len(line.curve) <= 60)


def _for_page(text: str, name: str) -> str:
    """The element alone, its names the drawing's own and its colors the page's."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    for number, color in enumerate(_CURVES, start=1):
        text = text.replace(color, f"var(--curve-{number})")
    text = text.replace(_INK, "currentColor")
    # The page says how large it is.
    return re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"', r"\1", text, count=1)
