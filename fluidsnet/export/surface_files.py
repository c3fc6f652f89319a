"""Surfaces of many frames, several at once."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from fluidsnet.errors import UserError
from fluidsnet.export.frames import Frame, Frames
from fluidsnet.export.in_order import in_order
from fluidsnet.export.sequence import SequenceFolder
from fluidsnet.export.surface import Mesh, SurfaceSettings, reconstruct, write_mesh


def surfaces(
    frames: Frames, settings: SurfaceSettings, workers: int
) -> Iterator[tuple[Frame, Mesh]]:
    """Yield each frame and its surface.

    Args:
        frames: Frames in three dimensions.
        settings: Settings of the reconstruction.
        workers: Processes, each with a frame; one takes all cores for each frame.

    Raises:
        UserError: A frame has no surface, or the frames lie in a plane.
    """
    _check_dimension(frames)
    radius = frames.radius()
    work = partial(_with_surface, radius=radius, settings=settings, threads=workers == 1)
    return in_order(work, frames, workers)


def write_surfaces(
    frames: Frames, folder: SequenceFolder, settings: SurfaceSettings, workers: int
) -> Iterator[None]:
    """Write a mesh file for each frame to an open folder, and yield after each.

    Args:
        frames: Frames in three dimensions.
        folder: Folder, whose suffix is the format of the meshes.
        settings: Settings of the reconstruction.
        workers: Processes, each with a frame; one takes all cores for each frame.

    Raises:
        UserError: As for `surfaces`.
    """
    _check_dimension(frames)
    radius = frames.radius()
    work = partial(_write_surface, radius=radius, settings=settings, threads=workers == 1)
    items = ((frame, folder.next_path(frame.time)) for frame in frames)
    return in_order(work, items, workers)


def _check_dimension(frames: Frames) -> None:
    """Raise a `UserError` if the particles lie in a plane."""
    if frames.dimension != 3:
        raise UserError(f"{frames.name} is in two dimensions; surfaces need three.")


def _with_surface(
    frame: Frame, radius: float, settings: SurfaceSettings, threads: bool
) -> tuple[Frame, Mesh]:
    return frame, reconstruct(frame, radius, settings, threads)


def _write_surface(
    item: tuple[Frame, Path], radius: float, settings: SurfaceSettings, threads: bool
) -> None:
    frame, path = item
    write_mesh(path, reconstruct(frame, radius, settings, threads))
