"""Tests of closed surfaces and of OBJ files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tetrahedron import TRIANGLES, VERTICES, write_tetrahedron

from datamodules.generate.obj import enclosed, enclosed_volume, read_obj
from fluidsnet.errors import UserError


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    write_tetrahedron(tmp_path / "a.obj")
    vertices, triangles = read_obj(tmp_path / "a.obj")
    np.testing.assert_array_equal(vertices, VERTICES)
    np.testing.assert_array_equal(triangles, TRIANGLES)


def test_faces_of_four_corners_and_negative_indices(tmp_path: Path) -> None:
    lines = [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "-8/1/1 -6/2/1 -2/3/1 -4/4/1", "2 6 8 4"]
    path = tmp_path / "cube.obj"
    path.write_text("\n".join([*lines, *(f"f {face}" for face in faces)]))
    vertices, triangles = read_obj(path)
    assert triangles.shape == (12, 3)
    assert enclosed_volume(vertices, triangles) == pytest.approx(1)
    random = np.random.default_rng(0).uniform(-0.5, 1.5, size=(1000, 3))
    expected = ((random > 0) & (random < 1)).all(axis=1)
    np.testing.assert_array_equal(enclosed(random, vertices, triangles), expected)


def test_points_inside_a_tetrahedron() -> None:
    assert enclosed_volume(VERTICES, TRIANGLES) == pytest.approx(1 / 6)
    assert enclosed_volume(VERTICES, TRIANGLES[:, ::-1]) == pytest.approx(1 / 6)
    # A lattice, whose columns meet the edges and corners of the surface.
    axis = np.linspace(-0.2, 1.2, 15)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    signed = np.minimum(points.min(axis=1), 1 - points.sum(axis=1))
    clear = np.abs(signed) > 1e-6
    found = enclosed(points, VERTICES, TRIANGLES)
    np.testing.assert_array_equal(found[clear], signed[clear] > 0)
    assert found.any()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("v 0 0 0\n", "there are no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "the surface is open"),
        ("v 0 0 zero\n", "not an OBJ file of text"),
        ("v 0 0 0\nf 1 2 3\nf 1 3 2\n", "a vertex that is not in the file"),
    ],
)
def test_a_file_that_is_no_closed_surface_is_an_error(
    tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(UserError, match=f"bad.obj: .*{words}"):
        read_obj(path)


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        read_obj(tmp_path / "none.obj")
