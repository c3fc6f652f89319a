"""Sentences and tables on the data of runs: trained on, and measured on."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from datamodules.schema import DAMAGE, SPLITS, Header, open_valid, simulations
from fluidsnet.errors import UserError
from fluidsnet.report.document import Note, Section, Table
from fluidsnet.report.run import CONFIG, Group, Results, Run
from fluidsnet.report.tables import frame
from fluidsnet.reporting.table import Cell

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
    notes: dict[str, None] = {}
    for run in runs:
        results = group.results.get(run.name)
        if results is None:
            others = " and ".join(str(it.path or "data not noted") for it in run.results)
            notes[f"{run.name} has no results on these data, but on {others}."] = None
        elif results.data:
            notes[f"Measured on {_summary(results)}."] = None
            path = results.path
            if path is not None and path.is_file() and _sha256(path) != results.data.get("sha256"):
                text = f"{path} has changed since {run.name} was measured: its sha256 is now "
                notes[f"{text}{_sha256(path)[:12]}."] = None
            if "root" in run.data and not run.trained_on(results):
                notes[f"{run.name} was trained on other data: {run.data['root']}."] = None
        elif results.tables or results.pictures:
            text = "not noted: the results are of an old version, which kept them in the run's"
            notes[f"The data that {run.name} was measured on are {text} folder."] = None
    return [Note(text) for text in notes]


def _summary(results: Results) -> str:
    data = results.data
    parts = [f"{data.get('simulations')} simulations", f"{data.get('frames')} frames"]
    if data.get("frame_range"):
        parts.append(f"frame range {data['frame_range']}")
    if data.get("sample_every") not in (None, 1):
        parts.append(f"sampled every {data['sample_every']} frames")
    parts.append(f"stride {data.get('stride')}")
    if isinstance(data.get("time_step"), int | float):
        parts.append(f"time step {1000 * data['time_step']:g} ms")
    return f"{results.path} (sha256 {str(data.get('sha256'))[:12]}): {', '.join(parts)}"


@lru_cache
def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
