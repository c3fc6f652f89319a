"""Sentences and tables on the data of runs: trained on, and measured on."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from datamodules.schema import DAMAGE, SPLITS, Header, open_valid, simulations
from fluidsnet.errors import UserError
from fluidsnet.report.document import Note, Section, Table
from fluidsnet.report.run import CONFIG, Group, Results, Run
from fluidsnet.report.tables import frame
from fluidsnet.reporting.table import Cell

#: Notes on the data that are shown only where they differ.
_DEFAULTS: dict[str, Any] = {"frame_range": [0, None], "sample_every": 1}
_COLUMNS = ("split", "simulations", "frames", "fluid particles", "solid particles", "time s")


def data_section(runs: Sequence[Run]) -> Section:
    """Describe the data that each run was trained on."""
    section = Section("Data")
    seen: dict[str, str] = {}
    for run in runs:
        if run.config is None:
            text = f"The data that {run.name} was trained on are unknown without its {CONFIG}."
            section.parts.append(Note(text, missing=True))
            continue
        sentences, rows = _describe(run)
        first = seen.setdefault(str((sentences, run.data.get("root"))), run.name)
        if first != run.name:
            section.parts.append(Note(f"{run.name} has the same data as {first}."))
            continue
        prefix = f"{run.name}: " if len(runs) > 1 else ""
        section.parts.append(Note(prefix + " ".join(sentences), missing=not rows))
        if rows:
            name = "data" if len(runs) == 1 else f"data_{run.name}"
            caption = f"Data files of {run.name}"
            section.parts.append(Table(name, caption, frame(_COLUMNS, rows)))
    return section


def measured_notes(runs: Sequence[Run], group: Group) -> list[Note]:
    """Return sentences on the data that the results of a group were measured on."""
    notes: list[str] = []
    for run in runs:
        results = group.results.get(run.name)
        if results is None:
            others = " and ".join(it.path for it in run.results)
            notes.append(f"{run.name} has no results on these data, but on {others}.")
        elif results.data:
            notes.append(f"Measured on {_summary(results)}.")
            noted = str(results.data.get("sha256")).split(", ")
            for path, digest in zip(results.files, noted, strict=False):
                if _sha256(path) not in (None, digest):
                    text = f"{path} has changed since {run.name} was measured"
                    notes.append(f"{text}: its sha256 is now {str(_sha256(path))[:12]}.")
            if "root" in run.data and not run.trained_on(results):
                notes.append(f"{run.name} was trained on other data: {run.data['root']}.")
        elif results.tables or results.pictures:
            text = f"The data that {run.name} was measured on are not noted"
            notes.append(f"{text}, as in runs of older versions.")
    return [Note(text) for text in dict.fromkeys(notes)]


def _summary(results: Results) -> str:
    parts = [
        f"{name.replace('_', ' ')} {value}"
        for name, value in results.data.items()
        if name not in ("root", "file", "sha256", "time_step") and value != _DEFAULTS.get(name)
    ]
    time_step = results.data.get("time_step")
    if isinstance(time_step, int | float):
        parts.append(f"time step {1000 * time_step:g} ms")
    digests = ", ".join(digest[:12] for digest in str(results.data.get("sha256")).split(", "))
    return f"{results.path} (sha256 {digests}): {', '.join(parts)}"


def _sha256(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _describe(run: Run) -> tuple[list[str], list[list[Cell]]]:
    """Return sentences on the training data, and a row for each split that can be read."""
    root = run.data.get("root")
    if not isinstance(root, str):
        return ["The configuration names no data folder."], []
    sentences = [f"Trained on the data of {root}."]
    rows: list[list[Cell]] = []
    header = None
    for split in SPLITS:
        path = Path(root) / f"{split}.h5"
        if not path.exists():
            continue
        try:
            header, row = _row(path)
        except (UserError, *DAMAGE) as error:
            sentences.append(f"{split}.h5 cannot be read: {error}")
        else:
            rows.append([split, *row])
    if header is None:
        return [*sentences, f"No data file is found at {root} from the working folder."], []
    stride = run.data.get("stride", 1)
    corners = zip(header.domain_lower, header.domain_upper, strict=True)
    size = " × ".join(f"{high - low:g}" for low, high in corners)
    sentences.append(
        f"Scene {header.scene} in {size} m, solver {header.solver}, particle radius "
        f"{header.particle_radius:g} m; a frame every {1000 * header.dt:g} ms, a step every "
        f"{1000 * header.dt * (stride if isinstance(stride, int) else 1):g} ms."
    )
    return sentences, rows


def _row(path: Path) -> tuple[Header, list[Cell]]:
    with open_valid(path) as file:
        header = Header.read(file)
        groups = [file[name] for name in simulations(file)]
        frames = [int(group["position"].shape[0]) for group in groups]
        fluid = [int(group["position"].shape[1]) for group in groups]
        solid = [int(group["solid_position"].shape[-2]) for group in groups]
    time = sum(count - 1 for count in frames) * header.dt
    return header, [len(groups), sum(frames), _range(fluid), _range(solid), time]


def _range(counts: list[int]) -> str:
    least, most = min(counts, default=0), max(counts, default=0)
    return f"{least:,}" if least == most else f"{least:,} to {most:,}"
