"""Tests of the shapes of fluid bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from tetrahedron import write_tetrahedron

from datamodules.generate.bodies import Quaternion, turned
from datamodules.generate.shapes import HARMONICS, Ball, Cuboid, Mesh, Shape, Torus

RADIUS = 0.02
BUMPS = tuple((0.25 * np.cos(np.arange(HARMONICS))).tolist())


@pytest.fixture(params=["cuboid", "ball", "bumpy ball", "torus", "mesh"])
def shape(request: pytest.FixtureRequest, tmp_path: Path) -> Shape:
    write_tetrahedron(tmp_path / "tetrahedron.obj")
    shapes: dict[str, Shape] = {
        "cuboid": Cuboid((0.4, 0.8, 0.6)),
        "ball": Ball(0.4),
        "bumpy ball": Ball(0.4, BUMPS),
        "torus": Torus(0.4, 0.16),
        "mesh": Mesh(str(tmp_path / "tetrahedron.obj"), 1.0),
    }
    return shapes[request.param]


def test_particles_fill_the_volume(shape: Shape) -> None:
    particles = shape.particles(RADIUS)
    assert len(particles) * (2 * RADIUS) ** 3 == pytest.approx(shape.volume(), rel=0.08)
    distances, _ = KDTree(particles).query(particles, k=2)
    np.testing.assert_allclose(distances[:, 1], 2 * RADIUS, rtol=1e-6)


def test_the_surface_bounds_the_particles_in_any_rotation(shape: Shape) -> None:
    random = np.random.default_rng(0)
    particles, surface = shape.particles(RADIUS / 2), shape.surface()
    for _ in range(5):
        w, x, y, z = random.normal(size=4) / 1.0
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        rotation: Quaternion = (w / norm, x / norm, y / norm, z / norm)
        inner, outer = turned(particles, rotation), turned(surface, rotation)
        # 2,000 points miss the extreme one by some thousandths of the size.
        below = inner.min(axis=0) - outer.min(axis=0)
        above = outer.max(axis=0) - inner.max(axis=0)
        assert min(below.min(), above.min()) > -0.002
        assert max(below.max(), above.max()) < 4 * RADIUS or isinstance(shape, Mesh)


def test_a_scaled_shape_has_the_cube_of_the_volume(shape: Shape) -> None:
    scaled = shape.scaled(1.5)
    assert scaled.volume() == pytest.approx(1.5**3 * shape.volume())
    np.testing.assert_allclose(scaled.surface(), 1.5 * shape.surface())
    assert len(scaled.particles(1.5 * RADIUS)) == len(shape.particles(RADIUS))


def test_a_cuboid_of_whole_layers_is_full() -> None:
    particles = Cuboid((0.3, 0.4, 0.6)).particles(0.05)
    assert len(particles) == 3 * 4 * 6
    np.testing.assert_allclose(particles.max(axis=0), [0.1, 0.15, 0.25])
    np.testing.assert_allclose(particles.min(axis=0), [-0.1, -0.15, -0.25])


def test_volumes_by_hand(tmp_path: Path) -> None:
    assert Ball(0.5).volume() == pytest.approx(4 / 3 * np.pi * 0.125)
    assert Torus(0.5, 0.2).volume() == pytest.approx(2 * np.pi**2 * 0.5 * 0.04)
    write_tetrahedron(tmp_path / "tetrahedron.obj")
    assert Mesh(str(tmp_path / "tetrahedron.obj"), 2.0).volume() == pytest.approx(8 / 6)


def test_the_flattest_direction_of_a_deformed_ball() -> None:
    # 3 z² - 1 is least, -1, on the equator.
    ball = Ball(2.0, (0.0, 0.0, 0.0, 0.0, 0.4))
    assert ball.flattest() == pytest.approx(0.6, abs=1e-4)
    assert ball.contains(
        np.array([[1.19, 0, 0], [1.21, 0, 0], [0, 0, 3.59], [0, 0, 3.61]])
    ).tolist() == [
        True,
        False,
        True,
        False,
    ]


def test_turning_follows_the_right_hand() -> None:
    half = np.sqrt(0.5)
    found = turned(np.eye(3), (half, 0.0, half, 0.0))  # 90 degrees about y
    np.testing.assert_allclose(found, [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-12)
