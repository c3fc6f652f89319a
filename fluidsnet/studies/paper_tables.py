"""The paper's own figures of speed, as printed, to stand beside measured ones."""

from __future__ import annotations

from fluidsnet.reporting.table import Cell, markdown

#: What they were measured on (section 5.2).
HARDWARE = "Nvidia GeForce GTX 1080 Ti, Intel Xeon E5-2623"

#: Table 3: scene, particles, simulation s, precomputation s [8], prediction s [8], speed-up.
BATCHES: list[tuple[str, int, float, float, float, float]] = [
    ("a cuboid dropping on a basin", 28623, 1.58, 3.42, 0.58, 21.79),
    ("dam breaking", 46430, 2.68, 4.23, 0.68, 31.53),
    ("a liquid drop falling into a pool", 66987, 5.13, 6.83, 0.83, 49.44),
]

#: Table 4: scene, its size in m, particles, simulation s, prediction s, speed-up.
LARGE: list[tuple[str, str, int, float, float, float]] = [
    ("Fig. 10b", "10.5 × 10.5 × 10.5", 73234, 4.06, 0.75, 5.41),
    ("Fig. 10c", "14 × 14 × 14", 127417, 7.47, 1.07, 6.98),
    ("Fig. 10e", "9 × 6 × 9", 139788, 8.33, 1.11, 7.50),
    ("Fig. 10f", "12 × 8 × 12", 305460, 23.51, 1.78, 13.21),
    ("Fig. 10i", "10.5 × 10.5 × 10.5", 270272, 17.43, 1.70, 10.25),
    ("Fig. 10j", "14 × 14 × 14", 618043, 50.51, 2.76, 18.30),
]

_HEADING = f"The paper's ({HARDWARE}; a frame there is one solver step):\n\n"


def batches() -> str:
    """Table 3 as Markdown."""
    rows: list[list[Cell]] = [
        [name, f"{particles:,}", simulation, before, prediction, up]
        for name, particles, simulation, before, prediction, up in BATCHES
    ]
    header = (
        "paper's scene", "particles", "simulation s", "precomputation s [8]",
        "prediction s [8]", "×",
    )  # fmt: skip
    return _HEADING + markdown(header, rows)


def large_scenes() -> str:
    """Table 4 as Markdown."""
    rows: list[list[Cell]] = [
        [name, size, f"{particles:,}", simulation, prediction, up]
        for name, size, particles, simulation, prediction, up in LARGE
    ]
    header = ("paper's scene", "m", "particles", "simulation s", "prediction s", "×")
    return _HEADING + markdown(header, rows)
