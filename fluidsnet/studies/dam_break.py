"""The paper's dam break with any number of particles of the same size, in a scaled domain."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from datamodules.generate.job import SolverName
from datamodules.generate.recipe import Recipe
from datamodules.generate.scenes import CLEARANCE, DamBreak, Vector
from datamodules.schema import SceneAttributes
from datamodules.start_file import start_header, write_start

#: Edges of the paper's domain, m, and particle radius, m (section 5.1).
DOMAIN: Vector = (6.0, 4.0, 6.0)
RADIUS = 0.05
#: Cells of its background grid (Table 1); in a larger scene the cells are larger.
CELLS = (18, 12, 18)
#: Edges of the column over those of the domain: the middle of the ranges that `DamBreak` draws
#: from. At the paper's size they give 46,400 particles; the paper's scene has 46,430.
SHARES = (0.45, 0.78, 0.92)


@final
@dataclass(frozen=True)
class Dam:
    """A dam break scene.

    Attributes:
        layers: Number of particles of the column along x, y and z.
        domain: Edges of the domain, m; the paper's, scaled by one factor.
    """

    layers: tuple[int, int, int]
    domain: Vector

    @classmethod
    def of(cls, particles: int) -> Dam:
        """Return the dam break whose number of particles is nearest to a given one."""
        spacing = 2 * RADIUS
        unscaled = float(np.prod(np.array(SHARES) * np.array(DOMAIN))) / spacing**3
        scale = max((particles / unscaled) ** (1 / 3), 4 * spacing / min(DOMAIN))
        edges = scale * np.array(DOMAIN)
        ideal = np.array(SHARES) * edges / spacing
        most = np.floor((edges - 2 * CLEARANCE * RADIUS) / spacing)

        def around(axis: int) -> range:
            middle, reach = round(ideal[axis]), max(2, round(0.08 * ideal[axis]))
            return range(max(1, middle - reach), max(1, min(middle + reach, int(most[axis]))) + 1)

        def difference(layers: tuple[int, int, int]) -> float:
            # The difference in number decides, then the difference in shape.
            distortion = float(np.abs(np.log(np.array(layers) / ideal)).sum())
            return abs(prod(layers) - particles) + distortion

        columns = (
            (x, y, int(np.clip(round(particles / (x * y)), 1, most[2])))
            for x, y in product(around(0), around(1))
        )
        width, height, depth = map(float, edges)
        return cls(min(columns, key=difference), (width, height, depth))

    @property
    def particles(self) -> int:
        """Number of fluid particles."""
        return prod(self.layers)

    def recipe(
        self, solver: SolverName, frames: int, frame_interval: float, solver_step: float
    ) -> Recipe:
        """Return the recipe of one simulation with `frames` after the start; times in s."""
        width, height, depth = (2 * RADIUS * np.array(self.layers) / self.domain).tolist()
        return Recipe(
            scene=DamBreak(self.domain, (width, width), (height, height), (depth, depth)),
            particle_radius=RADIUS,
            train=1,
            val=0,
            test=0,
            frames=frames + 1,
            frame_interval=frame_interval,
            solver=solver,
            solver_step=solver_step,
        )

    def write_start(self, path: Path, frames: int, frame_interval: float) -> None:
        """Write a data file of the column at rest, without the solver; all frames are equal.

        Wall particles are a diameter apart.
        """
        random = np.random.default_rng(0)
        lattice = RADIUS * (CLEARANCE + 1 + 2 * _grid(*map(np.arange, self.layers)))
        # Random offsets of up to 0.1 radii, so that no two neighbors are equally far.
        lattice += random.uniform(-0.1, 0.1, lattice.shape) * RADIUS
        write_start(
            path,
            start_header("DamBreak", RADIUS, frame_interval),
            self._scene(),
            (lattice, np.zeros_like(lattice)),
            self._walls(),
            frames=frames + 1,
            seed=[0],
        )

    def _scene(self) -> SceneAttributes:
        return SceneAttributes(
            domain_lower=(0.0, 0.0, 0.0),
            domain_upper=self.domain,
            gravity=(0.0, -9.81, 0.0),
            density0=1000.0,
            viscosity=0.0,
        )

    def _walls(self) -> NDArray[np.float32]:
        sides = []
        for axis, edge in enumerate(self.domain):
            across = [np.arange(0, self.domain[other], 2 * RADIUS) for other in range(3)]
            across[axis] = np.array([0.0, edge])
            sides.append(_grid(*across))
        return np.concatenate(sides).astype(np.float32)


def _grid(*axes: NDArray[Any]) -> NDArray[np.float64]:
    """Return the points (N, 3) of a grid with the given coordinates."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1, dtype=np.float64).reshape(-1, 3)
