"""Times printed in the paper (section 5.5), for comparison with measured ones."""

from __future__ import annotations

from fluidsnet.reporting.table import markdown

#: Fluid particles of the scenes of Table 3.
TABLE_3_PARTICLES = (28623, 46430, 66987)

_TABLE_3 = [
    ("a cuboid dropping on a basin", "28,623", 1.58, 3.42, 0.58, 21.79),
    ("dam breaking", "46,430", 2.68, 4.23, 0.68, 31.53),
    ("a liquid drop falling into a pool", "66,987", 5.13, 6.83, 0.83, 49.44),
]

_TABLE_4 = [
    ("Fig. 10b", "10.5 × 10.5 × 10.5", "73,234", 4.06, 0.75, 5.41),
    ("Fig. 10c", "14 × 14 × 14", "127,417", 7.47, 1.07, 6.98),
    ("Fig. 10e", "9 × 6 × 9", "139,788", 8.33, 1.11, 7.50),
    ("Fig. 10f", "12 × 8 × 12", "305,460", 23.51, 1.78, 13.21),
    ("Fig. 10i", "10.5 × 10.5 × 10.5", "270,272", 17.43, 1.70, 10.25),
    ("Fig. 10j", "14 × 14 × 14", "618,043", 50.51, 2.76, 18.30),
]

# Hardware of section 5.2.
_HEADING = (
    "The paper's times (Nvidia GeForce GTX 1080 Ti, Intel Xeon E5-2623; its frame is one solver "
    "step):\n\n"
)


def table_3() -> str:
    """Return Table 3, many frames predicted at once, as Markdown."""
    header = (
        "paper's scene", "particles", "simulation s", "precomputation s [8]",
        "prediction s [8]", "×",
    )  # fmt: skip
    return _HEADING + markdown(header, _TABLE_3)


def table_4() -> str:
    """Return Table 4, large scenes, as Markdown."""
    header = ("paper's scene", "m", "particles", "simulation s", "prediction s", "×")
    return _HEADING + markdown(header, _TABLE_4)
