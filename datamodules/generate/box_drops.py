"""Scene kind of bodies of random shape in boxes of random size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np
from scipy.spatial import KDTree

from datamodules.generate.bodies import MovingBody, Quaternion, Range, Vector, turned, vector
from datamodules.generate.obj import read_obj
from datamodules.generate.scenes import CLEARANCE, FEWEST_LAYERS, DrawnScene, SceneKind
from datamodules.generate.shapes import HARMONICS, Ball, Cuboid, Mesh, Points, Shape, Torus
from fluidsnet.errors import UserError

#: Draws of all bodies of a scene, and of the place of one body, before giving up.
_DRAWS, _PLACES = 200, 50
#: Least distance between the particles of two bodies, in spacings: one of them is air.
_APART = 2.0
#: Greatest relative difference between the volume of a body and that of its particles, which
#: is larger in bodies too thin for their particles.
_TOLERANCE = 0.2


@final
@dataclass
class BoxDrops(SceneKind):
    """Bodies of random shape, rotation, place and velocity that fall into a box of random size.

    These are the scenes of Ummenhofer et al. 2020, "Lagrangian Fluid Simulation with Continuous
    Convolutions". A body is a cuboid, a ball, or a closed surface: a ball deformed by spherical
    harmonics, a torus, or an OBJ file. Bodies are particles on a cubic lattice, at rest density.

    Args:
        width: x edge of the box, m.
        height: y edge of the box, m.
        depth: z edge of the box, m.
        bodies: Least and greatest number of bodies.
        volume: Volume of all bodies together, m³.
        speed: Speed of each body at the start, m/s; its direction is random.
        viscosity: Coefficient of the solver, one value for each simulation, with a uniform
            logarithm; by default that of the recipe.
        meshes: OBJ files with closed surfaces, or folders of them, which replace the deformed
            balls and the tori.

    Raises:
        UserError: a range is not possible, or a mesh cannot be read.
    """

    width: Range = (2.0, 4.0)
    height: Range = (2.0, 2.0)
    depth: Range = (2.0, 2.0)
    bodies: tuple[int, int] = (1, 3)
    volume: Range = (0.5, 0.875)
    speed: Range = (0.0, 1.5)
    viscosity: Range | None = None
    meshes: list[Path] | None = None

    def __post_init__(self) -> None:
        for name in ("width", "height", "depth", "bodies", "volume", "speed", "viscosity"):
            low, high = getattr(self, name) or (1, 1)
            if not (low <= high < np.inf and (low > 0 or (name == "speed" and low == 0))):
                raise UserError(
                    f"{name} of BoxDrops is [{low}, {high}]; give the least and the greatest "
                    f"value, both {'at least' if name == 'speed' else 'above'} zero."
                )
        for path in self._obj_files():
            read_obj(path)

    def scaled(self, factor: float) -> BoxDrops:
        def longer(extent: Range, power: int = 1) -> Range:
            return factor**power * extent[0], factor**power * extent[1]

        return replace(
            self,
            width=longer(self.width),
            height=longer(self.height),
            depth=longer(self.depth),
            volume=longer(self.volume, 3),
        )

    def sample(self, random: np.random.Generator, particle_radius: float) -> DrawnScene:
        edges = [random.uniform(*extent) for extent in (self.width, self.height, self.depth)]
        domain = vector(np.array(edges))
        viscosity = None
        if self.viscosity is not None:
            viscosity = float(np.exp(random.uniform(*np.log(self.viscosity))))
        for _ in range(_DRAWS):
            bodies = self._bodies(random, domain, particle_radius)
            if bodies is not None:
                return DrawnScene(domain, [*bodies], viscosity)
        raise UserError(
            f"BoxDrops finds no place for its bodies in a box of {domain} m with particles of "
            f"radius {particle_radius} m; set a smaller volume, fewer bodies or smaller particles."
        )

    def _bodies(
        self, random: np.random.Generator, domain: Vector, particle_radius: float
    ) -> list[MovingBody] | None:
        """Draw the bodies of a scene; return None if they do not fit."""
        shares = random.uniform(0.5, 1.5, size=random.integers(*self.bodies, endpoint=True))
        volumes = random.uniform(*self.volume) * shares / shares.sum()
        clearance = (1 + CLEARANCE) * particle_radius
        bodies: list[MovingBody] = []
        occupied = np.empty((0, 3))
        for volume in volumes:
            shape = self._shape(random, volume, 2 * particle_radius)
            rotation = _rotation(random)
            particles = turned(shape.particles(particle_radius), rotation)
            if abs(len(particles) * (2 * particle_radius) ** 3 / volume - 1) > _TOLERANCE:
                return None
            lower = clearance - particles.min(axis=0)
            upper = np.array(domain) - clearance - particles.max(axis=0)
            if (lower > upper).any():
                return None
            center = _free_place(random, particles, occupied, (lower, upper), particle_radius)
            if center is None:
                return None
            direction = random.normal(size=3)
            direction *= random.uniform(*self.speed) / np.linalg.norm(direction)
            bodies.append(MovingBody(shape, center, rotation, vector(direction)))
            occupied = np.concatenate([occupied, particles + np.array(center)])
        return bodies

    def _shape(self, random: np.random.Generator, volume: float, spacing: float) -> Shape:
        """Draw a shape with a volume, m³; edges of a cuboid are a whole number of spacings, m."""
        form = random.integers(3)
        if form == 0:
            edges = random.uniform(0.5, 1.5, size=3)
            edges *= (volume / edges.prod()) ** (1 / 3)
            return Cuboid(vector(spacing * np.maximum(np.round(edges / spacing), FEWEST_LAYERS)))
        shape = Ball(1.0) if form == 1 else self._closed_surface(random)
        return shape.scaled((volume / shape.volume()) ** (1 / 3))

    def _closed_surface(self, random: np.random.Generator) -> Shape:
        if files := self._obj_files():
            return Mesh(str(files[random.integers(len(files))].resolve()), 1.0)
        if random.integers(2):
            return Torus(1.0, random.uniform(0.3, 0.6))
        harmonics = random.normal(size=HARMONICS)
        harmonics *= random.uniform(0.3, 0.6) / (1 - Ball(1.0, tuple(harmonics)).flattest())
        return Ball(1.0, tuple(harmonics.tolist()))

    def _obj_files(self) -> list[Path]:
        """Return the OBJ files of `meshes`."""
        files = []
        for path in self.meshes or []:
            found = sorted(path.glob("*.obj")) if path.is_dir() else [path]
            if not found:
                raise UserError(f"{path}: there is no OBJ file in this folder; check `meshes`.")
            files += found
        return files


def _rotation(random: np.random.Generator) -> Quaternion:
    """Draw a rotation; all are equally likely."""
    quaternion = random.normal(size=4)
    w, x, y, z = (quaternion / np.linalg.norm(quaternion)).tolist()
    return w, x, y, z


def _free_place(
    random: np.random.Generator,
    particles: Points,
    occupied: Points,
    room: tuple[Points, Points],
    particle_radius: float,
) -> Vector | None:
    """Draw a place in the room where particles are apart from those there are, or None."""
    apart = _APART * 2 * particle_radius
    tree = KDTree(occupied)
    for _ in range(_PLACES):
        center = vector(random.uniform(*room))
        # Without a particle in this reach the distance is infinite.
        distances, _ = tree.query(particles + np.array(center), distance_upper_bound=apart)
        if np.isinf(distances).all():
            return center
    return None
