"""Picture and movie of a simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from fluidsnet.export import Panel, read_field_data, read_frame, side_by_side
from fluidsnet.export.camera import up_axis
from fluidsnet.export.movie import View, write_movie
from fluidsnet.export.speed_colors import speed_scale
from fluidsnet.export.vtkhdf import Array
from fluidsnet.reporting.file_places import file_places
from fluidsnet.studies.simulate.run import Course
from fluidsnet.studies.simulate.start import Start

#: Times of the panels, as shares of the simulation.
_SHARES = (0.0, 0.15, 0.4, 1.0)
#: Frames whose speeds set the color scale.
_SCALE_FRAMES = 20
#: Distance from the walls from which a solid is drawn, particle radii.
_INSIDE = 2.0
#: Height of the box that is drawn above the fluid, as a share of the scene's.
_ABOVE = 0.05


def draw_picture(path: Path, start: Start, course: Course) -> None:
    """Draw the start, two states between and the end to a PNG file.

    Args:
        path: Path of the picture.
        start: Start of the simulation.
        course: What was stored of it.
    """
    view, shown = _view(start, course), drawn_solids(start)
    times = read_field_data(course.path)["time"]
    chosen = [round(share * (course.frames - 1)) for share in _SHARES]
    panels = []
    for step in chosen if course.frames >= len(chosen) else [0, course.frames - 1]:
        position, data = read_frame(course.path, step)
        solid = _solids_at(start, course, step)[shown]
        panels.append(Panel(f"{times[step]:.2f} s", position, data["speed"], solid))
    side_by_side(
        path,
        panels,
        view.lower,
        view.upper,
        view.particle_radius,
        speed_max=view.speed_max,
        gravity=view.gravity,
    )


def draw_movie(path: Path, start: Start, course: Course) -> int:
    """Draw the stored frames to an MP4 file; return the number of frames.

    Args:
        path: Path of the movie.
        start: Start of the simulation.
        course: What was stored of it.

    Raises:
        UserError: A package is missing, or the file cannot be written.
    """
    shown = drawn_solids(start)
    moving = (course.solids, shown) if course.solids and start.solids is not None else None
    return write_movie(path, course.path, _view(start, course), moving)


def drawn_solids(start: Start) -> Array:
    """Return which solids are drawn, (M,): those that are not in the walls of the box."""
    state, scene = start.state, start.state.scene
    gap = _INSIDE * scene.particle_radius
    place = state.solid_position
    inside = (place > scene.domain_lower + gap) & (place < scene.domain_upper - gap)
    if scene.dimension == 2:
        inside[:, 2] = True
    drawn = inside.all(dim=1)
    if start.solids is not None:
        drawn = drawn | _moved(start)
    return drawn.cpu().numpy()


def _moved(start: Start) -> torch.Tensor:
    """Return which solids are elsewhere at one of the known steps, (M,)."""
    assert start.solids is not None
    place = start.state.solid_position
    last = start.known_steps or 7
    moved = torch.zeros(len(place), dtype=torch.bool, device=place.device)
    # A swing may be back at its start at one of these steps, not at all of them.
    for step in {1, (last + 1) // 2, last}:
        moved |= (start.solids[step][0].to(place.device) - place).abs().amax(dim=1) > 1e-5
    return moved


def _solids_at(start: Start, course: Course, step: int) -> Array:
    """Return the solids (M, 3) of a stored frame, m."""
    if course.solids is None:
        return np.empty((0, 3))
    return read_frame(course.solids, step if start.solids is not None else 0)[0]


def _view(start: Start, course: Course) -> View:
    state, scene = start.state, start.state.scene
    ends = torch.cat([scene.domain_lower, scene.domain_upper])
    lower, upper = file_places(ends, state).astype(float)
    radius = scene.particle_radius
    if not start.closed:
        # The box of all that was there; the scene's is as large as a fall.
        solid = _solids_at(start, course, 0)
        lower = np.minimum(course.lower, solid.min(axis=0, initial=np.inf)) - radius
        upper = np.maximum(course.upper, solid.max(axis=0, initial=-np.inf)) + radius
    shown = _solids_at(start, course, 0)[drawn_solids(start)]
    lowest = np.minimum(course.lower, shown.min(axis=0, initial=np.inf))
    highest = np.maximum(course.upper, shown.max(axis=0, initial=-np.inf))
    lower, upper = _cut(lower, upper, scene.gravity[0].cpu().numpy(), lowest, highest)
    frames = np.unique(np.linspace(0, course.frames - 1, _SCALE_FRAMES).astype(int))
    speeds = [read_frame(course.path, int(it))[1]["speed"] for it in frames]
    return View(
        lower=lower,
        upper=upper,
        gravity=scene.gravity[0].cpu().numpy(),
        particle_radius=radius,
        speed_max=speed_scale(speeds),
        title=start.name,
        solid=shown,
    )


def _cut(
    lower: Array, upper: Array, gravity: Array, lowest: Array, highest: Array
) -> tuple[Array, Array]:
    """Return the corners of the part of a box below the height that is reached, m.

    Args:
        lower: (3,) corner of the box, m.
        upper: (3,) corner of the box, m.
        gravity: (3,) m/s².
        lowest: (3,) least coordinates that are reached, m.
        highest: (3,) greatest coordinates, m.
    """
    up, room = up_axis(gravity), _ABOVE * (upper - lower)
    cut_lower = np.where(up < 0, np.maximum(lower, lowest - room), lower)
    cut_upper = np.where(up > 0, np.minimum(upper, highest + room), upper)
    return cut_lower, cut_upper
