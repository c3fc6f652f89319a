"""``fluidsnet inspect``: summary of a data file and checks for suspicious values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from textwrap import indent
from typing import final

import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from datamodules.schema import DAMAGE, Header, SceneAttributes, open_valid, simulations
from datamodules.suspicions import Suspicions
from fluidsnet.errors import UserError
from fluidsnet.printable import printable
from fluidsnet.progress import Progress

#: Texts of `_scene_texts` that are not worth a line.
_USUAL = {
    "from": "(0, 0, 0) m",
    "surface tension": "0",
    "periodic": "no",
    "dimension": "3",
    "solids": "at rest",
}


def inspect_simulation(
    group: h5py.Group, header: Header
) -> tuple[dict[str, object], list[NDArray[np.float64]], list[str], list[str]]:
    """Summarize a simulation, reading it frame by frame.

    Returns:
        Row of a table; corners of the fluid's bounding box over all frames, m; and sentences
        on damage and on suspicious values.
    """
    name = group.name.lstrip("/")
    scene = SceneAttributes.read(group)
    frames, fluid = group["position"].shape[:2]
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    suspicions = Suspicions(scene, header)
    for frame in Progress(range(frames), desc=f"reading /{name}", unit="frame", leave=False):
        position = group["position"][frame].astype(np.float64)
        if suspicions.add(frame, position, group["velocity"][frame].astype(np.float64)):
            lower = np.minimum(lower, position.min(axis=0))
            upper = np.maximum(upper, position.max(axis=0))
    time = (frames - 1) * header.dt
    cost = float(group["solver_seconds"][()].sum()) / time if time else 0.0
    row = {
        "simulation": name,
        "frames": frames,
        "time s": f"{time:.3f}",
        "fluid": fluid,
        "solid": group["solid_position"].shape[-2],
        "fastest m/s": f"{suspicions.fastest:.2f}",
        "solver s per s (threads)": f"{cost:.1f} ({_threads(group)})",
    }
    return row, [lower, upper], suspicions.damage(group), suspicions.sentences(group)


@final
@dataclass(frozen=True)
class Summary:
    """Summary of a file.

    Attributes:
        text: What is in it, damaged and suspicious.
        damaged: `fit`, `test` and `predict` refuse some of its frames.
    """

    text: str
    damaged: bool


def summarize(path: Path) -> Summary:
    """Return a summary of a file.

    Raises:
        UserError: the file is not valid, damaged, or not that of its checksum.
    """
    with open_valid(path) as file:
        header = Header.read(file)
        try:
            reports = [inspect_simulation(file[name], header) for name in simulations(file)]
            scenes = [_scene_texts(file[name]) for name in simulations(file)]
        except DAMAGE as error:
            raise UserError(
                f"{path}: a frame cannot be read; the file is damaged ({error})."
            ) from error
    differ = {name for scene in scenes for name in scene if scene[name] != scenes[0][name]}
    rows = [
        row | {name: text for name, text in scene.items() if name in differ}
        for (row, *_), scene in zip(reports, scenes, strict=True)
    ]
    shared = {
        name: text
        for name, text in scenes[0].items()
        if name not in differ and text != _USUAL.get(name)
    }
    corners = np.array([corners for _, corners, *_ in reports])
    about = {
        "scene": header.scene,
        "solver": f"{header.solver}, version {header.solver_version}",
        "particle radius": f"{header.particle_radius:g} m, support {header.support_radius:g} m",
        "frame interval": f"{1000 * header.dt:g} ms",
        **shared,
    }
    lines = [
        f"{path}: {path.stat().st_size / 1e6:.1f} MB, {len(reports)} simulation(s)",
        *(f"  {name:<16} {text}" for name, text in about.items()),
        "",
        indent(pd.DataFrame(rows).to_string(index=False), "  "),
        "",
        f"  fluid lies between ({_vector(corners[:, 0].min(axis=0))}) and "
        f"({_vector(corners[:, 1].max(axis=0))}) m",
    ]
    for title, kind in (("damaged, and refused by fit, test and predict", 2), ("suspicious", 3)):
        texts = [f"  /{it[0]['simulation']}: {text}" for it in reports for text in it[kind]]
        lines += ["", f"{title}:", *texts] if texts else []
    if not any(it[2] or it[3] for it in reports):
        lines.append("  nothing suspicious")
    return Summary(printable("\n".join(lines)), damaged=any(it[2] for it in reports))


def _threads(group: h5py.Group) -> str:
    """Return the number of threads of the solver; a question mark where the file has none."""
    count = np.asarray(group.attrs.get("threads", "?"))
    return str(count) if count.dtype.kind in "iu" and count.ndim == 0 else "?"


def _scene_texts(group: h5py.Group) -> dict[str, str]:
    """Return the scene of a simulation as text with units."""
    scene = SceneAttributes.read(group)
    return {
        "domain": f"{_numbers(np.subtract(scene.domain_upper, scene.domain_lower), ' x ')} m",
        "from": f"({_numbers(scene.domain_lower)}) m",
        "gravity": f"{_numbers(scene.gravity)} m/s²",
        "density": f"{scene.density0:g} kg/m³",
        "viscosity": f"{scene.viscosity:g}",
        "surface tension": f"{scene.surface_tension:g}",
        "periodic": ", ".join(axis for axis, on in zip("xyz", scene.periodic, strict=True) if on)
        or "no",
        "dimension": f"{scene.dimension}",
        "solids": "move" if group["solid_position"].ndim == 3 else "at rest",
    }


def _numbers(values: Iterable[float], separator: str = ", ") -> str:
    return separator.join(f"{value:g}" for value in values)


def _vector(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.3f}" for value in values)
