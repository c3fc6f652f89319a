"""Movie of a trajectory file: PyVista draws the frames, ffmpeg writes them.

The camera keeps still, up is against gravity, and speed has one color scale over all frames.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from fluidsnet.errors import UserError
from fluidsnet.export.camera import Camera
from fluidsnet.export.colors import BACKGROUND, FLOOR, LINES, SOLID, TEXT
from fluidsnet.export.speed_colors import speed_colormap, speed_colors
from fluidsnet.export.vtkhdf import read_field_data, read_frame
from fluidsnet.progress import Progress

if TYPE_CHECKING:
    import pyvista

#: Greatest number of frames a second; of more, every second or third is drawn.
MOST_FRAMES = 30.0
#: Size of the picture, pixels; even, as the codec needs.
SIZE = (960, 720)

#: Fragment of VTK's shader that turns a splat into a sphere, lit as in `render`.
_SPHERE = """//VTK::Color::Impl
    float squared = dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy);
    if (squared > 1.0) { discard; }
    vec3 normal = vec3(offsetVCVSOutput.xy, sqrt(1.0 - squared));
    float light = 0.62 + 0.43 * max(dot(normal, vec3(-0.35, 0.75, 0.56)), 0.0);
    ambientColor *= light;
    diffuseColor *= light;
"""

Array = NDArray[Any]


@final
@dataclass(frozen=True)
class View:
    """Box, scale and size of the particles in a movie.

    Attributes:
        lower: (3,) corner of the box, m.
        upper: (3,) corner of the box, m.
        gravity: (3,) m/s².
        particle_radius: m.
        speed_max: Upper end of the color scale, m/s.
        title: Text above the time.
        solid: (K, 3) of solid particles to show, m; they are gray.
    """

    lower: Array
    upper: Array
    gravity: Array
    particle_radius: float
    speed_max: float
    title: str = ""
    solid: Array = field(default_factory=lambda: np.empty((0, 3)))


def check_movie(path: Path) -> None:
    """Check that a movie can be written, before the work that it shows.

    Raises:
        UserError: The name does not end in .mp4, or a package is missing.
    """
    if path.suffix.lower() != ".mp4":
        raise UserError(f"{path}: the name of a movie must end in .mp4.")
    for name in ("pyvista", "imageio_ffmpeg"):
        try:
            import_module(name)
        except ImportError as error:
            raise UserError(
                f"A movie needs the package {name}, which is not installed; install it with "
                "`pip install 'fluidsnet[movie]'`."
            ) from error


def drawn_frames(times: NDArray[np.float64]) -> tuple[list[int], float]:
    """Return the steps to draw of a trajectory, and the number of them in a second.

    Time in the movie runs as in the simulation.

    Args:
        times: (T,) s; equally far apart but for the last.
    """
    rate = 1 / (times[1] - times[0]) if len(times) > 1 else 1.0
    stride = max(1, int(np.ceil(rate / MOST_FRAMES - 1e-6)))
    return list(range(0, len(times), stride)), float(rate / stride)


def write_movie(
    path: Path, trajectory: Path, view: View, solids: tuple[Path, NDArray[np.bool_]] | None = None
) -> int:
    """Draw a trajectory file to an MP4 file; return its number of frames.

    The file gets its name when it is whole. One frame is in memory at a time.

    Args:
        path: Path of the movie.
        trajectory: File of the particles, with their `speed`.
        view: Box, scale and size of the particles.
        solids: File of the solids, with the times of the trajectory, and (M,) those to show;
            None where they rest, see `View.solid`.

    Raises:
        UserError: A package is missing, or the file cannot be written.
    """
    check_movie(path)
    times = read_field_data(trajectory)["time"]
    steps, rate = drawn_frames(times)
    with _writer(path, rate) as send, _Stage(view, len(read_frame(trajectory, 0)[0])) as stage:
        for step in Progress(steps, desc="drawing the movie", unit="frame"):
            position, data = read_frame(trajectory, step)
            solid = None if solids is None else read_frame(solids[0], step)[0][solids[1]]
            send(stage.draw(position, data["speed"], float(times[step]), solid))
    return len(steps)


@contextmanager
def _writer(path: Path, rate: float) -> Iterator[Any]:
    """Yield a function that appends a picture (height, width, 3) to a movie."""
    import imageio_ffmpeg

    # ffmpeg takes the format from the ending.
    partial = path.with_name(f".{path.stem}.{os.getpid()}.tmp.mp4")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path}: the movie cannot be written: {error}.") from error
    try:
        movie = imageio_ffmpeg.write_frames(
            str(partial), SIZE, fps=rate, quality=8, macro_block_size=2
        )
        movie.send(None)
        yield lambda picture: movie.send(np.ascontiguousarray(picture))
        movie.close()
        partial.replace(path)
    except OSError as error:
        raise UserError(f"{path}: the movie cannot be written: {error}.") from error
    finally:
        partial.unlink(missing_ok=True)


@final
class _Stage:
    """Off-screen picture of a box with particles."""

    def __init__(self, view: View, particles: int) -> None:
        import pyvista

        # VTK tells of each display that it tries before it draws without one.
        pyvista.vtk_verbosity("off")
        self.view = view
        plotter: Any = pyvista.Plotter
        self.plotter = plotter(off_screen=True, window_size=list(SIZE))
        self.plotter.set_background(BACKGROUND)
        self._cloud = self._spheres(pyvista.PolyData(np.zeros((particles, 3), np.float32)))
        solid = np.asarray(view.solid, np.float32).reshape(-1, 3)
        self._solid = self._spheres(pyvista.PolyData(solid)) if len(solid) else None
        self._add_box(pyvista)
        self._add_scale(pyvista)
        self._time = self.plotter.add_text(" ", font_size=12, color=TEXT, position="upper_left")
        self._look()

    def __enter__(self) -> _Stage:
        return self

    def __exit__(self, *exception: object) -> None:
        self.plotter.close()

    def draw(self, position: Array, speed: Array, time: float, solid: Array | None) -> Array:
        """Return the picture (height, width, 3) of a state."""
        self._cloud.points = np.asarray(position, np.float32)
        self._cloud["color"] = np.rint(255 * speed_colors(speed, self.view.speed_max)).astype("u1")
        if solid is not None and self._solid is not None:
            self._solid.points = np.asarray(solid, np.float32)
        text = f"{self.view.title}\n{time:.2f} s".strip()
        self._time.SetText(2, text)
        self.plotter.render()
        return np.asarray(self.plotter.screenshot(None, return_img=True))[..., :3]

    def _spheres(self, cloud: pyvista.PolyData) -> pyvista.PolyData:
        """Add particles, gray at first, and return them."""
        cloud["color"] = np.full((cloud.n_points, 3), round(255 * SOLID), np.uint8)
        actor = self.plotter.add_mesh(
            cloud,
            scalars="color",
            rgb=True,
            style="points_gaussian",
            emissive=False,
            lighting=False,
            show_scalar_bar=False,
        )
        # Splats are taken for translucent, and would be drawn in the order of the rows.
        actor.ForceOpaqueOn()
        actor.mapper.scale_factor = self.view.particle_radius
        actor.mapper.SetSplatShaderCode(_SPHERE)
        return cloud

    def _add_scale(self, pyvista: Any) -> None:
        """Add the color scale of the speed."""
        mapper = pyvista.DataSetMapper(self._cloud)
        mapper.lookup_table = pyvista.LookupTable(
            cmap=speed_colormap(), scalar_range=(0.0, self.view.speed_max)
        )
        self.plotter.add_scalar_bar(
            "speed, m/s",
            mapper=mapper,
            color=TEXT,
            n_labels=3,
            fmt="{:.2g}",
            title_font_size=18,
            label_font_size=14,
            width=0.3,
            height=0.07,
            position_x=0.68,
            position_y=0.92,
        )

    def _add_box(self, pyvista: Any) -> None:
        camera = Camera(self.view.lower, self.view.upper, SIZE, self.view.gravity)
        corners = camera.corners()
        floor = pyvista.PolyData(corners[camera.floor()], faces=[4, 0, 1, 2, 3])
        self.plotter.add_mesh(floor, color=FLOOR, lighting=False)
        bounds = np.stack([self.view.lower, self.view.upper], axis=1).ravel()
        self.plotter.add_mesh(pyvista.Box(bounds), style="wireframe", color=LINES, lighting=False)

    def _look(self) -> None:
        camera = Camera(self.view.lower, self.view.upper, SIZE, self.view.gravity)
        center = (self.view.lower + self.view.upper) / 2
        self.plotter.camera_position = [camera.eye, center, camera.up]
        self.plotter.camera.view_angle = camera.view_angle(SIZE[0] / SIZE[1])
        self.plotter.reset_camera_clipping_range()
