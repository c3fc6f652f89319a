"""``fluidsnet export``: simulations as files for other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeVar, final

import numpy as np

from fluidsnet.errors import UserError
from fluidsnet.export.bgeo import write_bgeo
from fluidsnet.export.frames import Frame, Frames, trajectory_frames
from fluidsnet.export.ply import write_ply
from fluidsnet.export.sequence import SequenceFolder
from fluidsnet.export.surface import MeshFormat, SurfaceSettings
from fluidsnet.export.surface_files import surfaces, write_surfaces
from fluidsnet.export.usd import UsdFile
from fluidsnet.progress import Progress
from fluidsnet.studies.export.data_file import data_frames
from fluidsnet.studies.machine import cores
from fluidsnet.studies.parser import Parser

T = TypeVar("T")

_DESCRIPTION = """
Write a trajectory of `fluidsnet predict`, or a simulation of a data file, for Houdini, Blender,
Maya and ParaView: particles as USD, PLY or BGEO, or their surface as meshes. Example:
fluidsnet export runs/demo/results/demo/rollouts/00000.vtkhdf --to usd --output dam.usdc
"""

_POINT_WRITERS: dict[str, Callable[[Path, Frame], None]] = {"ply": write_ply, "bgeo": write_bgeo}


@final
@dataclass(frozen=True)
class ExportOptions:
    """Options of the export.

    Attributes:
        to: Format: usd, one file; ply or bgeo, a folder with a file of particles a frame; surface,
            a folder with a mesh a frame.
        output: File, for usd, or folder; what an earlier export wrote there is replaced.
        simulation: Simulation of a data file, such as 00000; by default the first.
        first: Index of the first frame; negative counts from the end.
        last: Index of the last frame, included; negative counts from the end.
        every: Frames from one that is written to the next.
        radius: Particle radius, m; by default that of the source.
        fps: Time codes per second of a USD file; by default a frame is a time code.
        surface: Add the surface to a USD file.
        mesh_format: Files of the surface.
        mesh: Settings of the surface, for usd and surface.
        workers: Processes that reconstruct surfaces, each a frame; by default one a core. With 1,
            all cores work on one frame, which takes the least memory.
    """

    to: Literal["usd", "ply", "bgeo", "surface"]
    output: Path
    simulation: str | None = None
    first: int = 0
    last: int = -1
    every: int = 1
    radius: float | None = None
    fps: float | None = None
    surface: bool = False
    mesh_format: MeshFormat = "ply"
    mesh: SurfaceSettings = field(default_factory=SurfaceSettings)
    workers: int = field(default_factory=cores)

    def __post_init__(self) -> None:
        if self.radius is not None and not 0 < self.radius < np.inf:
            raise UserError(f"--radius is {self.radius}; set it above zero.")
        if self.workers < 1:
            raise UserError(f"--workers is {self.workers}; set at least 1.")
        if self.to != "usd":
            if self.surface:
                raise UserError("--surface is for --to usd; for files of meshes, use --to surface.")
            if self.fps is not None:
                raise UserError(f"--fps is for --to usd; --to {self.to} writes a file a frame.")


def export_command(arguments: Sequence[str]) -> None:
    """Write the files and print where they are.

    Raises:
        UserError: An option, the source or the output cannot be used, or a package is missing.
    """
    parser = Parser(prog="fluidsnet export", description=_DESCRIPTION)
    parser.add_argument("source", type=Path, metavar="TRAJECTORY", help=".vtkhdf or data file")
    parser.add_class_arguments(ExportOptions, skip={"surface"})
    parser.add_argument("--surface", action="store_true", help="add the surface to a USD file")
    parsed = vars(parser.instantiate(parser.parse_args(list(arguments))))
    source = parsed.pop("source")
    print(export(source, ExportOptions(**parsed)))


def export(source: Path, options: ExportOptions) -> str:
    """Write the files; return a line on what was written.

    Args:
        source: Trajectory file or data file.
        options: What to write.

    Raises:
        UserError: As `export_command`.
    """
    frames = _frames(source, options)
    write = _write_usd if options.to == "usd" else _write_sequence
    try:
        replaced = write(frames, options)
    except OSError as error:
        raise UserError(f"{options.output}: cannot be written: {error}.") from error
    older = "; it replaces an older export" if replaced else ""
    return f"{options.output}: {len(frames)} frames of {frames.name}{older}."


def _frames(source: Path, options: ExportOptions) -> Frames:
    """Return the frames that are to be written."""
    if source.suffix == ".vtkhdf":
        if options.simulation is not None:
            raise UserError(f"--simulation is for data files; {source} is a single trajectory.")
        frames = trajectory_frames(source)
    else:
        frames = data_frames(source, options.simulation)
    if options.radius is not None:
        frames = replace(frames, particle_radius=options.radius)
    return frames.select(options.first, options.last, options.every)


def _write_usd(frames: Frames, options: ExportOptions) -> bool:
    """Write a USD file; return True if there was one."""
    frames.radius()
    with UsdFile(options.output, frames, options.fps) as file:
        if options.surface:
            meshes = surfaces(frames, options.mesh, options.workers)
            for frame, mesh in _shown(meshes, len(frames)):
                file.append(frame, mesh)
        else:
            for frame in _shown(frames, len(frames)):
                file.append(frame)
    return file.replaced


def _write_sequence(frames: Frames, options: ExportOptions) -> bool:
    """Write a folder of files; return True if there was one."""
    suffix = options.mesh_format if options.to == "surface" else options.to
    folder = SequenceFolder(options.output, f".{suffix}")
    with folder:
        if options.to == "surface":
            written = write_surfaces(frames, folder, options.mesh, options.workers)
            for _ in _shown(written, len(frames)):
                pass
        else:
            write = _POINT_WRITERS[options.to]
            for frame in _shown(frames, len(frames)):
                write(folder.next_path(frame.time), frame)
    return folder.replaced


def _shown(items: Iterable[T], total: int) -> Iterator[T]:
    """Yield the items and show the progress."""
    with Progress(total=total, unit="frame", desc="export") as bar:
        for item in items:
            yield item
            bar.update()
