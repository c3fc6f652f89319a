"""Movies of trajectory files, read back by ffmpeg."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from numpy.typing import NDArray

from fluidsnet.errors import UserError
from fluidsnet.export import TrajectoryFile
from fluidsnet.export.movie import SIZE, View, check_movie, drawn_frames, write_movie

# imageio-ffmpeg leaves the pipes of a process that has ended.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")

LOWER, UPPER, RADIUS = np.zeros(3), np.array([1.5, 1.0, 1.5]), 0.025


def block(count: int = 10) -> NDArray[np.float64]:
    """Return particles in the middle of the box, two radii apart."""
    steps = (np.arange(count) - count / 2) * 2 * RADIUS
    cube = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    return np.asarray(cube + UPPER / 2)


def trajectory(path: Path, frames: int, interval: float, speeds: list[float]) -> Path:
    """Write a block that moves to the right and has a speed in each frame."""
    with TrajectoryFile(path, particles=1000) as file:
        for frame in range(frames):
            place = block() + np.array([0.3 * frame / frames, 0, 0])
            file.append(frame * interval, place, {"speed": np.full(1000, speeds[frame])})
    return path


def view(**changes: Any) -> View:
    values: dict[str, Any] = {
        "lower": LOWER, "upper": UPPER, "gravity": np.array([0, -9.81, 0]),
        "particle_radius": RADIUS, "speed_max": 2.0, **changes,
    }  # fmt: skip
    return View(**values)


def pictures(path: Path) -> tuple[dict[str, Any], list[NDArray[np.int16]]]:
    """Return what ffmpeg says of a movie, and its pictures."""
    reader = imageio_ffmpeg.read_frames(str(path))
    described: dict[str, Any] = next(reader)
    shape = (SIZE[1], SIZE[0], 3)
    return described, [np.frombuffer(it, np.uint8).reshape(shape).astype(int) for it in reader]


def test_a_movie_has_the_frames_and_their_time(tmp_path: Path) -> None:
    source = trajectory(tmp_path / "a.vtkhdf", 5, 0.04, [0.0, 0.5, 1.0, 2.0, 2.0])
    assert write_movie(tmp_path / "a.mp4", source, view(title="a block")) == 5
    described, shown = pictures(tmp_path / "a.mp4")
    assert len(shown) == 5 and described["size"] == SIZE and described["fps"] == 25
    blue = [it[(it[..., 2] > 120) & (it[..., 2] >= it[..., 0])] for it in shown]
    # Faster is whiter, on one scale.
    red = [float(it[:, 0].mean()) for it in blue]
    assert red[0] < red[1] < red[2] < red[3] and red[4] == pytest.approx(red[3], abs=8)
    assert min(map(len, blue)) > 5_000
    # The block moves; the camera does not: the box, away from the block, stays.
    centers = [np.argwhere((it[..., 2] > 120)[150:600]).mean(axis=0)[1] for it in shown]
    assert centers[4] > centers[0] + 30
    assert np.abs(shown[0][:, :150][150:] - shown[4][:, :150][150:]).max() < 40
    assert (shown[0][:, :150][150:].max(axis=2) > 60).sum() > 100
    assert [it.name for it in tmp_path.iterdir() if ".tmp" in it.name] == []


def test_a_near_particle_hides_a_far_one(tmp_path: Path) -> None:
    place = block()
    inside = (np.abs(place - UPPER / 2 + RADIUS) < 3 * RADIUS).all(axis=1)
    assert inside.sum() > 20
    with TrajectoryFile(tmp_path / "a.vtkhdf", particles=1000) as file:
        # Whatever the order of the rows.
        for step, order in enumerate((np.arange(1000), np.arange(1000)[::-1])):
            file.append(0.1 * step, place[order], {"speed": np.where(inside[order], 2.0, 0.0)})
    write_movie(tmp_path / "a.mp4", tmp_path / "a.vtkhdf", view())
    for picture in pictures(tmp_path / "a.mp4")[1]:
        assert (picture[150:600].min(axis=2) > 200).sum() < 50  # none of the white ones


def test_up_is_against_gravity(tmp_path: Path) -> None:
    turn = np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)])
    low = block() - np.array([0, 0.2, 0])
    shown = []
    for matrix, gravity in ((np.eye(3), (0, -9.81, 0)), (turn, (0, 0, -9.81))):
        with TrajectoryFile(tmp_path / "a.vtkhdf", particles=1000) as file:
            file.append(0.0, low @ matrix, {"speed": np.ones(1000)})
        corners = np.array([LOWER, UPPER]) @ matrix
        ends = {"lower": corners.min(axis=0), "upper": corners.max(axis=0)}
        write_movie(tmp_path / "a.mp4", tmp_path / "a.vtkhdf", view(gravity=gravity, **ends))
        shown.append(pictures(tmp_path / "a.mp4")[1][0])
    assert np.abs(shown[0] - shown[1]).mean() < 1
    row, _ = np.argwhere(shown[0][..., 2] - shown[0][..., 0] > 100).mean(axis=0)
    assert row > SIZE[1] / 2


def test_solids_are_gray(tmp_path: Path) -> None:
    source = trajectory(tmp_path / "a.vtkhdf", 1, 0.04, [0.0])
    solid = block(6) + np.array([0, 0, 0.5])
    write_movie(tmp_path / "a.mp4", source, view(solid=solid))
    (picture,) = pictures(tmp_path / "a.mp4")[1]
    gray = (np.ptp(picture, axis=-1) < 12) & (np.abs(picture.mean(axis=-1) - 100) < 45)
    assert gray.sum() > 3000


def test_time_runs_as_in_the_simulation() -> None:
    assert drawn_frames(0.02 * np.arange(7)) == ([0, 2, 4, 6], pytest.approx(25))
    assert drawn_frames(0.08 * np.arange(3)) == ([0, 1, 2], pytest.approx(12.5))
    assert drawn_frames(np.zeros(1)) == ([0], 1.0)


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(
        UserError, match=r"needs the package imageio_ffmpeg, .* 'fluidsnet\[movie\]'"
    ):
        check_movie(Path("a.mp4"))


def test_a_movie_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"a.avi: the name of a movie must end in .mp4"):
        check_movie(tmp_path / "a.avi")
    source = trajectory(tmp_path / "a.vtkhdf", 1, 0.04, [0.0])
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="the movie cannot be written"):
        write_movie(tmp_path / "file" / "a.mp4", source, view())
