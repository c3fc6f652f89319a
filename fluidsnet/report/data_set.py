"""The data that a run was trained and tested on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from datamodules.schema import DAMAGE, SPLITS, Header, open_valid, simulations
from fluidsnet.errors import UserError
from fluidsnet.report.grid import Grid
from fluidsnet.reporting.table import Cell


def data_settings(config: Mapping[str, Any] | None) -> dict[str, Any]:
    """The arguments of a configuration's data module."""
    data = (config or {}).get("data")
    settings = data.get("init_args", data) if isinstance(data, Mapping) else None
    return dict(settings) if isinstance(settings, Mapping) else {}


def describe(config: Mapping[str, Any] | None) -> tuple[list[str], Grid | None]:
    """What the data are, and a table of what each split holds.

    Args:
        config: of the run.

    Returns:
        sentences, and the table if the data are still where the run found them.
    """
    settings = data_settings(config)
    root = settings.get("root")
    if not isinstance(root, str):
        return ["The configuration names no folder of data."], None
    rows: list[tuple[Cell, ...]] = []
    sentences = [f"The data are those of {root}."]
    header = None
    for split in SPLITS:
        path = Path(root) / f"{split}.h5"
        if not path.exists():
            continue
        try:
            found, row = _row(path)
        except (UserError, *DAMAGE) as error:
            sentences.append(f"{split}.h5 cannot be read: {error}")
            continue
        header = header or found
        rows.append((split, *row))
    if header is None:
        return [*sentences, f"There are none at {root} now, seen from this folder."], None
    stride = settings.get("stride", 1)
    sentences.append(_words(header, stride if isinstance(stride, int) else 1))
    columns = ("split", "simulations", "frames", "fluid particles", "solid particles", "time s")
    return sentences, Grid(columns, tuple(rows))


def _row(path: Path) -> tuple[Header, tuple[Cell, ...]]:
    with open_valid(path) as file:
        header = Header.read(file)
        groups = [file[name] for name in simulations(file)]
        frames = [int(group["position"].shape[0]) for group in groups]
        fluid = [int(group["position"].shape[1]) for group in groups]
        solid = [int(group["solid_position"].shape[-2]) for group in groups]
    time = sum(count - 1 for count in frames) * header.dt
    return header, (len(groups), sum(frames), _range(fluid), _range(solid), time)


def _range(counts: list[int]) -> str:
    least, most = min(counts, default=0), max(counts, default=0)
    return f"{least:,}" if least == most else f"{least:,} to {most:,}"


def _words(header: Header, stride: int) -> str:
    corners = zip(header.domain_lower, header.domain_upper, strict=True)
    size = " × ".join(f"{high - low:g}" for low, high in corners)
    return (
        f"Scene {header.scene} in {size} m, solver {header.solver}, particle radius "
        f"{header.particle_radius:g} m; a frame every {1000 * header.dt:g} ms, a step every "
        f"{1000 * header.dt * stride:g} ms."
    )
