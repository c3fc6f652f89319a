"""Pictures of particles: panels such as truth and prediction at several times.

Each particle is drawn as a lit sphere with a depth buffer, in perspective from slightly above;
up is against gravity. Color is speed, from blue at rest to white, as in Fig. 12 of the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fluidsnet.export.camera import Camera
from fluidsnet.export.colors import BACKGROUND, FLOOR, LINES, SOLID, TEXT
from fluidsnet.export.speed_colors import speed_colormap, speed_colors, speed_scale
from fluidsnet.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DPI = 100
_PANEL = (640, 460)  # greatest size of a panel, pixels
# With more than two columns: greatest width, and pixels of all panels, to bound the file size.
_MAX_WIDTH, _MAX_PIXELS = 2400, 3_200_000
_GAP, _TITLE, _BAR, _TITLE_GAP = 24, 38, 110, 12  # pixels
_SUPERSAMPLING = 2  # spheres are drawn this much larger, then averaged, for smooth outlines

_TOWARDS_LIGHT = np.array([-0.35, 0.75, 0.56])  # right, up, towards the eye


@dataclass(frozen=True)
class Panel:
    """Picture of one state.

    Attributes:
        title: Title, such as ``truth (IISPH), 0.50 s``.
        position: (N, 3), m.
        speed: (N,), m/s.
        solid: (K, 3) of solid particles to show, m; they are gray.
    """

    title: str
    position: NDArray[Any]
    speed: NDArray[Any]
    solid: NDArray[Any] = field(default_factory=lambda: np.empty((0, 3)))


def side_by_side(
    path: str | Path,
    panels: Sequence[Panel],
    domain_lower: ArrayLike,
    domain_upper: ArrayLike,
    particle_radius: float,
    speed_max: float | None = None,
    columns: int = 2,
    gravity: ArrayLike | None = None,
) -> None:
    """Draw panels in columns to a PNG file, all with one color scale.

    More than two columns have smaller panels: the picture is at most 2,400 pixels wide.
    Particles that are not finite, or outside the picture, are counted in the title of their
    panel.

    Args:
        path: Path of the picture.
        panels: Panels, row after row, such as the truth then the prediction.
        domain_lower: (3,) lower corner of the box, m.
        domain_upper: (3,) upper corner of the box, m.
        particle_radius: m.
        speed_max: Upper end of the color scale, m/s; by default the 99.5th percentile of the
            speeds in all panels.
        columns: Number of panels in a row.
        gravity: (3,) m/s², which is drawn downward; by default y is up.

    Raises:
        ValueError: the panels do not fill their rows, the shapes in a panel do not match, or
            a number is not above zero.
    """
    if speed_max is not None and not speed_max > 0:
        raise ValueError(f"speed_max must be above zero, not {speed_max}")
    if columns < 1:
        raise ValueError(f"columns must be above zero, not {columns}")
    if not panels or len(panels) % columns:
        raise ValueError(f"panels go {columns} in a row; there are {len(panels)}")
    for panel in panels:
        if panel.position.shape != (len(panel.speed), 3) or panel.speed.ndim != 1:
            shapes = f"{panel.position.shape} and {panel.speed.shape}"
            raise ValueError(f"panel {panel.title!r}: expected (N, 3) and (N,), not {shapes}")
    # Imported here because matplotlib is slow to import.
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from PIL import Image

    rows = len(panels) // columns
    lower, upper = np.asarray(domain_lower, float), np.asarray(domain_upper, float)
    camera = Camera(lower, upper, _panel_size(rows, columns), gravity)
    top = speed_scale([panel.speed for panel in panels]) if speed_max is None else speed_max
    width = columns * (camera.width + _GAP) + _BAR
    height = rows * (camera.height + _TITLE) + _GAP
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor=BACKGROUND)
    for index, panel in enumerate(panels):
        row, column = divmod(index, columns)
        left = _GAP + column * (camera.width + _GAP)
        bottom = height - (row + 1) * (camera.height + _TITLE)
        box = (left / width, bottom / height, camera.width / width, camera.height / height)
        _draw(figure.add_axes(box), camera, panel, particle_radius, top)
    length = min(0.7 * height, 400) / height
    bar = figure.add_axes(((width - _BAR + 12) / width, 0.5 - length / 2, 14 / width, length))
    shown = ScalarMappable(Normalize(0.0, top), speed_colormap())
    scale = figure.colorbar(shown, cax=bar, extend="max", extendfrac=0.03)
    scale.outline.set_visible(False)
    scale.set_label("speed, m/s", color=TEXT, fontsize=11)
    bar.tick_params(colors=TEXT, labelsize=10, length=3)
    drawing = BytesIO()
    figure.savefig(drawing, dpi=_DPI, facecolor=BACKGROUND, pil_kwargs={"compress_level": 0})
    # The picture is blue and gray: 256 colors look the same and take a third of the bytes.
    picture = Image.open(drawing).convert("RGB")
    picture = picture.quantize(palette=picture.quantize(256), dither=Image.Dither.FLOYDSTEINBERG)
    with whole_file(Path(path)) as partial:
        picture.save(partial, format="PNG", optimize=True)


def _panel_size(rows: int, columns: int) -> tuple[int, int]:
    """Return the greatest width and height of a panel, pixels."""
    width, height = _PANEL
    if columns <= 2:
        return _PANEL
    available = (_MAX_WIDTH - _BAR) / columns - _GAP - 1  # sizes are rounded up
    shrunk = (_MAX_PIXELS / (rows * columns * width * height)) ** 0.5
    scale = min(1.0, available / width, shrunk)
    return int(scale * width), int(scale * height)


def _draw(axes: Axes, camera: Camera, panel: Panel, radius: float, top: float) -> None:
    """Draw one panel: floor, far edges, particles, near edges, title."""
    from matplotlib.collections import LineCollection

    corners = camera.project(camera.corners())
    floor = corners[camera.floor()]
    axes.fill(floor[:, 0], floor[:, 1], color=FLOOR, zorder=0)
    facing = (camera.eye < camera.lower, camera.eye > camera.upper)
    far: list[NDArray[Any]] = []
    near: list[NDArray[Any]] = []
    for start in range(8):
        for axis in range(3):
            if start >> axis & 1:
                continue
            # An edge is far if neither of its two faces faces the eye.
            seen = any(facing[start >> other & 1][other] for other in {0, 1, 2} - {axis})
            (near if seen else far).append(corners[[start, start | 1 << axis], :2])
    for edges, order, alpha in ((far, 1, 0.5), (near, 3, 0.7)):
        lines = LineCollection(edges, colors=LINES, linewidths=1.0, zorder=order, alpha=alpha)
        axes.add_collection(lines, autolim=False)
    picture, drawn = _spheres(camera, panel, radius, top)
    axes.imshow(picture, extent=(0, camera.width, camera.height, 0), zorder=2)
    axes.set_xlim(0, camera.width)
    axes.set_ylim(camera.height, 0)
    axes.set_axis_off()
    titles = [(axes.set_title(panel.title, color=TEXT, fontsize=12, loc="left", pad=6), 12)]
    if drawn < len(panel.position):
        hidden = f"{len(panel.position) - drawn} of {len(panel.position)} particles out of sight"
        titles.append((axes.set_title(hidden, color=TEXT, fontsize=10, loc="right", pad=6), 10))
    needed = sum(title.get_window_extent().width + _TITLE_GAP for title, _ in titles)
    needed -= _TITLE_GAP
    if needed > camera.width:
        for title, size in titles:
            title.set_fontsize(size * camera.width / needed)


def _spheres(
    camera: Camera, panel: Panel, radius: float, top: float
) -> tuple[NDArray[np.float32], int]:
    """Draw the particles.

    Returns:
        Picture (height, width, 4) of red, green, blue, opacity; and the number of fluid particles
        in it.
    """
    # Imported here because numba and torch are slow to import.
    from fluidsnet.kernels.spheres import nearest_spheres

    width, height = camera.width * _SUPERSAMPLING, camera.height * _SUPERSAMPLING
    position = np.concatenate([np.asarray(panel.position, float), panel.solid])
    with np.errstate(all="ignore"):
        center = camera.project(position)
    x, y, depth = center.T
    x, y = x * _SUPERSAMPLING, y * _SUPERSAMPLING
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(center).all(axis=1) & (depth > 0.2 * camera.distance)
        seen &= (x >= 0) & (x < width) & (y >= 0) & (y < height)
    order = np.flatnonzero(seen)
    x, y, depth = x[order], y[order], depth[order]
    size = np.maximum(radius * camera.pixels_per_meter(depth) * _SUPERSAMPLING, 0.8)
    owner = nearest_spheres(np.stack([x, y, depth], axis=1), size, radius, width, height).ravel()
    filled = np.flatnonzero(owner >= 0)
    particle = owner[filled]
    normal = np.stack(
        [
            (filled % width + 0.5 - x[particle]) / size[particle],
            -(filled // width + 0.5 - y[particle]) / size[particle],
        ]
    )
    normal = np.vstack([normal, np.sqrt(np.maximum(1 - (normal**2).sum(axis=0), 0))])
    light = 0.62 + 0.43 * np.clip(_TOWARDS_LIGHT @ normal, 0, 1)
    wet = order < len(panel.position)
    paint = np.full((len(order), 3), SOLID)
    paint[wet] = speed_colors(panel.speed[order[wet]], top)
    image: NDArray[np.float32] = np.zeros((height * width, 4), dtype=np.float32)
    image[filled, :3] = np.clip(paint[particle] * light[:, None], 0, 1)
    image[filled, 3] = 1
    image = image.reshape((height, width, 4))
    # Far faster than a sum over axes of two.
    blocks = np.zeros((camera.height, camera.width, 4), dtype=np.float32)
    for i in range(_SUPERSAMPLING):
        for j in range(_SUPERSAMPLING):
            blocks += image[i::_SUPERSAMPLING, j::_SUPERSAMPLING]
    opacity = blocks[..., 3:]
    blocks[..., :3] /= np.maximum(opacity, 1)
    return np.concatenate([blocks[..., :3], opacity / _SUPERSAMPLING**2], axis=2), int(wet.sum())
