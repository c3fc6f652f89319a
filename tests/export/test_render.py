"""Tests of the pictures of particles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from numpy.typing import NDArray

from fluidsnet.export import Panel, side_by_side
from fluidsnet.export.camera import Camera
from fluidsnet.kernels.spheres import nearest_spheres

LOWER, UPPER, RADIUS = (0.0, 0.0, 0.0), (1.5, 1.0, 1.5), 0.025


def block(count: int = 12) -> NDArray[np.float32]:
    """Return particles in the middle of the box, two radii apart."""
    steps = (np.arange(count) - count / 2) * 2 * RADIUS
    cube = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    return np.asarray(cube + np.array([0.75, 0.5, 0.75]), dtype=np.float32)


def panel(speed: float, position: NDArray[Any] | None = None, title: str = "") -> Panel:
    position = block() if position is None else position
    return Panel(title, position, np.full(len(position), speed))


def halves(path: Path) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the left and the right panel of a picture with one row, without the color bar."""
    picture = matplotlib.image.imread(path)[..., :3]
    width = (picture.shape[1] - 110) // 2
    return picture[45:, :width], picture[45:, width : 2 * width]


def fluid(picture: NDArray[Any]) -> NDArray[Any]:
    """Return the colors (n, 3) of the pixels with a particle, which are the bluest ones."""
    return picture[picture[..., 2] > 0.45]


def test_solids_are_gray_and_hide_what_is_behind_them(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    behind, before = block(4) - np.array([0, 0, 0.4]), block(14) + np.array([0, 0, 0.3])
    alone, hidden = Panel("", behind, np.zeros(64)), Panel("", behind, np.zeros(64), before)
    side_by_side(path, [alone, hidden], LOWER, UPPER, RADIUS, speed_max=1.0)
    left, right = halves(path)
    seen, covered = (((it[..., 2] - it[..., 0]) > 0.3).sum() for it in (left, right))
    assert seen > 500 and covered < 0.2 * seen
    gray = right[(np.ptp(right, axis=-1) < 0.06) & (right.mean(axis=-1) > 0.25)]
    assert len(gray) > 5000


def test_faster_is_whiter_on_one_scale(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    side_by_side(path, [panel(0.2), panel(2.0)], LOWER, UPPER, RADIUS)
    slow, fast = (fluid(half).mean(axis=0) for half in halves(path))
    assert fast.mean() > slow.mean() + 0.3
    assert slow[2] > slow[0] + 0.4  # blue
    assert np.ptp(fast) < 0.1  # white


def test_equal_speeds_look_equal_and_a_scale_can_be_given(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    means = []
    for top in (None, 4.0):
        side_by_side(path, [panel(1.0), panel(1.0)], LOWER, UPPER, RADIUS, speed_max=top)
        left, right = (fluid(half).mean() for half in halves(path))
        assert left == pytest.approx(right, abs=0.01)
        means.append(left)
    assert means[0] > means[1] + 0.2


def test_y_is_up_and_x_goes_right(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    centers = []
    for offset in ([0, -0.2, 0], [0, 0.2, 0], [0.3, 0, 0]):
        moved = (block(6) + np.array(offset)).astype(np.float32)
        side_by_side(path, [panel(0.0, moved)] * 2, LOWER, UPPER, RADIUS)
        left, _ = halves(path)
        centers.append(np.argwhere(left[..., 2] > 0.45).mean(axis=0))
    low, high, right = centers
    assert high[0] < low[0] - 50
    assert high[1] == pytest.approx(low[1], abs=8)
    assert right[1] > low[1] + 50


def test_a_near_particle_hides_a_far_one(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    wall = block(12)
    inside = np.tile(np.array([[0.75, 0.5, 0.75]], dtype=np.float32), (50, 1))
    position = np.concatenate([wall, inside])
    speed = np.concatenate([np.zeros(len(wall)), np.full(len(inside), 9.0)])
    side_by_side(path, [Panel("", position, speed)] * 2, LOWER, UPPER, RADIUS, speed_max=9.0)
    assert fluid(halves(path)[0])[:, 0].max() < 0.6  # the white ones are inside the blue block


def test_the_nearest_sphere_of_every_pixel_is_seen() -> None:
    rng = np.random.default_rng(0)
    width, height, radius = 50, 40, 0.3
    # Some reach beyond the picture, some are smaller than a pixel.
    center = rng.uniform((-3, -3, 2), (53, 43, 4), (60, 3))
    size = rng.uniform(0.3, 9, 60)
    row, column = np.mgrid[:height, :width] + 0.5
    apart = np.stack([column, row], axis=-1)[:, :, None] - center[:, :2]
    squared = (apart**2).sum(axis=-1) / size**2
    surface = center[:, 2] - radius * np.sqrt(np.maximum(1 - squared, 0))
    surface[squared >= 1] = np.inf
    expected = np.where((squared < 1).any(axis=-1), surface.argmin(axis=-1), -1)
    assert (expected >= 0).mean() > 0.5 and (expected < 0).any()
    assert np.array_equal(nearest_spheres(center, size, radius, width, height), expected)


def test_a_full_page_stays_small(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    rng = np.random.default_rng(0)
    panels = [
        Panel(f"{i}", rng.uniform(0, 1, (5000, 3)) * UPPER, rng.exponential(size=5000))
        for i in range(8)
    ]
    side_by_side(path, panels, LOWER, UPPER, RADIUS)
    assert path.stat().st_size < 1.5e6
    height, width = matplotlib.image.imread(path).shape[:2]
    assert height > 1200 and width > 1000


def test_a_prediction_that_blew_up_is_drawn_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib.axes import Axes

    titles: list[str] = []
    original = Axes.set_title

    def record(self: Axes, label: str, *args: Any, **kwargs: Any) -> Any:
        titles.append(label)
        return original(self, label, *args, **kwargs)

    monkeypatch.setattr(Axes, "set_title", record)
    wild = block()
    wild[:3], wild[3:8], wild[8:9] = np.nan, 1e6, -np.inf
    speed = np.full(len(wild), 1.0)
    speed[:2] = np.nan, np.inf
    gone = np.full((4, 3), np.nan)
    side_by_side(
        tmp_path / "picture.png",
        [panel(1.0, title="truth"), Panel("wild", wild, speed), panel(1.0), panel(np.nan, gone)],
        LOWER,
        UPPER,
        RADIUS,
    )
    counts = [title for title in titles if "out of sight" in title]
    assert counts == ["9 of 1728 particles out of sight", "4 of 4 particles out of sight"]


@pytest.mark.parametrize("upper", [(0.3, 4.0, 0.3), (9.0, 0.5, 2.0), (14.0, 14.0, 14.0)])
def test_boxes_of_every_shape(tmp_path: Path, upper: tuple[float, float, float]) -> None:
    path = tmp_path / "picture.png"
    position = np.random.default_rng(0).uniform(0, 1, (500, 3)) * upper
    side_by_side(path, [panel(0.0, position)] * 2, LOWER, upper, RADIUS)
    height, width = matplotlib.image.imread(path).shape[:2]
    assert 900 <= width < 1500 and 100 < height < 600


@pytest.mark.parametrize(
    ("rows", "columns", "widest"), [(2, 1, 790), (1, 3, 2100), (3, 4, 2400), (6, 5, 2400)]
)
def test_any_number_of_columns(tmp_path: Path, rows: int, columns: int, widest: int) -> None:
    """Test that panels are placed row after row, by speeds that rise from left to right."""
    path = tmp_path / "picture.png"
    rng = np.random.default_rng(0)
    panels = [
        Panel(f"{i}", rng.uniform(0, 1, (5000, 3)) * UPPER, i % columns + rng.uniform(0, 0.9, 5000))
        for i in range(rows * columns)
    ]
    side_by_side(path, panels, LOWER, UPPER, RADIUS, columns=columns)
    assert path.stat().st_size < 2e6
    picture = matplotlib.image.imread(path)[..., :3]
    assert 700 < picture.shape[1] <= widest
    down, across = (picture.shape[0] - 24) // rows, (picture.shape[1] - 110) // columns
    for row in range(rows):
        line = picture[row * down + 38 : (row + 1) * down]
        places = [line[:, column * across :][:, :across] for column in range(columns)]
        reds = [fluid(place)[:, 0].mean() for place in places]
        assert reds == sorted(reds) and len(set(reds)) == columns


def test_titles_that_are_too_long_are_set_smaller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    titles: list[tuple[float, float, float]] = []
    original = Figure.savefig

    def record(self: Figure, *args: Any, **kwargs: Any) -> None:
        for axes in self.axes[:-1]:
            for title in axes.findobj(Text):
                if title.get_text():
                    extent = title.get_window_extent()
                    titles.append((title.get_fontsize(), extent.x0, extent.x1))
        original(self, *args, **kwargs)

    monkeypatch.setattr(Figure, "savefig", record)
    lost = np.full((1000, 3), np.nan)
    panels = [panel(1.0, title="short"), panel(1.0, lost, "a rather long name, 0.80 s, not finite")]
    side_by_side(tmp_path / "picture.png", panels * 3, LOWER, UPPER, RADIUS, columns=6)
    short, long, count = sorted(titles, key=lambda title: title[1])[:3]
    assert short[0] == 12 and long[0] < 12 and count[0] < 10
    assert short[2] < long[1] and long[2] + 4 < count[1]


def test_wrong_arguments(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    for panels in ([], [panel(1.0)]):
        with pytest.raises(ValueError, match="2 in a row"):
            side_by_side(path, panels, LOWER, UPPER, RADIUS)
    with pytest.raises(ValueError, match="panel 'odd'"):
        odd = Panel("odd", block(), np.zeros(3))
        side_by_side(path, [odd, odd], LOWER, UPPER, RADIUS)
    with pytest.raises(ValueError, match="speed_max"):
        side_by_side(path, [panel(1.0)] * 2, LOWER, UPPER, RADIUS, speed_max=0.0)
    with pytest.raises(ValueError, match="4 in a row; there are 6"):
        side_by_side(path, [panel(1.0)] * 6, LOWER, UPPER, RADIUS, columns=4)
    with pytest.raises(ValueError, match="columns must be above zero"):
        side_by_side(path, [panel(1.0)] * 2, LOWER, UPPER, RADIUS, columns=0)
    assert not path.exists()


@pytest.mark.parametrize(
    ("turn", "gravity"),
    [
        # Rows are the axes of the scene along which x, y and z of a scene with y up are laid.
        (((1, 0, 0), (0, 0, 1), (0, -1, 0)), (0, 0, -9.81)),  # z up
        (((1, 0, 0), (0, 0, 1), (0, -1, 0)), (1.0, -0.5, -9.81)),  # and tilted
        (((-1, 0, 0), (0, -1, 0), (0, 0, 1)), (0, 9.81, 0)),  # upside down
        (((0, -1, 0), (1, 0, 0), (0, 0, 1)), (-9.81, 0, 0)),  # x up
    ],
)
def test_up_is_against_gravity(
    turn: tuple[tuple[int, ...], ...], gravity: tuple[float, float, float]
) -> None:
    matrix = np.array(turn, float)
    corners = np.array([LOWER, UPPER])
    usual = Camera(corners[0], corners[1], (640, 460), (0, -9.81, 0))
    laid = corners @ matrix
    camera = Camera(laid.min(axis=0), laid.max(axis=0), (640, 460), gravity)
    points = block(5).astype(float)
    np.testing.assert_allclose(camera.project(points @ matrix), usual.project(points), atol=1e-9)
    assert (camera.width, camera.height) == (usual.width, usual.height)
    floor = camera.corners()[camera.floor()] @ matrix.T
    assert (floor[:, 1] == 0).all() and len(np.unique(floor, axis=0)) == 4


def test_a_picture_of_a_scene_with_z_up_is_that_of_one_with_y_up(tmp_path: Path) -> None:
    turn = np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)])
    laid = np.array([LOWER, UPPER]) @ turn
    pictures = []
    for matrix, lower, upper, gravity in (
        (np.eye(3), LOWER, UPPER, None),
        (turn, laid.min(axis=0), laid.max(axis=0), (0, 0, -9.81)),
    ):
        path = tmp_path / "picture.png"
        shown = Panel("", block(6) @ matrix, np.linspace(0, 1, 216))
        side_by_side(path, [shown, shown], lower, upper, RADIUS, gravity=gravity)
        pictures.append(matplotlib.image.imread(path))
    assert np.abs(pictures[0] - pictures[1]).mean() < 1e-3
