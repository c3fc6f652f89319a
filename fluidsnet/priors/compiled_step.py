"""`PressureStep` by the compiled kernel: particles are sorted, stepped, and put back in order."""

from __future__ import annotations

from functools import partial
from typing import final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.kernels.cell_table import CellTable, CellTables
from fluidsnet.kernels.columns import as_array
from fluidsnet.kernels.near_lists import near_lists
from fluidsnet.kernels.near_rows import in_rows
from fluidsnet.kernels.pressure_step import Boxes, Numbers, State, Walls, pressure_step
from fluidsnet.kernels.prior_columns import density_and_walls
from fluidsnet.kernels.sph_sums import solid_volumes
from fluidsnet.kernels.threads import set_threads
from fluidsnet.neighbors.search import Neighbors
from fluidsnet.particles import Particles
from fluidsnet.priors.outcome import Outcome
from fluidsnet.sph import spline_height


@final
class CompiledStep:
    """Step of fluid particles by the compiled kernel; solids at rest are sorted once."""

    def __init__(self) -> None:
        self._tables = CellTables()
        self._volumes: TensorCache[NDArray[np.float32]] = TensorCache()

    def __call__(
        self,
        particles: Particles,
        searched: Particles,
        pressures: tuple[Tensor, Tensor],
        boxes: Boxes,
        numbers: Numbers,
        substeps: int,
    ) -> Outcome:
        """Return the state some substeps later.

        Args:
            particles: N fluid particles and the solid ones, float32 on the CPU.
            searched: The particles where neighbors are searched.
            pressures: (N,) m²/s, of the phases of divergence and density.
            boxes: Scene of each frame.
            numbers: Numbers of the step.
            substeps: Number of substeps.
        """
        fluid, solids = self._tables(searched)
        rates = as_array(searched.solid_velocity)[solids.row if searched.solids_move else slice(0)]
        walls = Walls(solids.place, self._solid_volumes(particles, solids), rates)
        lists = near_lists(fluid, solids, particles.scene.support_radius)
        set_threads(len(particles))
        values = (particles.position, particles.velocity, *pressures)
        place, velocity, upkeep, pressure = (as_array(it)[fluid.row] for it in values)
        state = _state(upkeep, pressure)
        pressure_step(place, velocity, fluid.frame, lists, walls, boxes, numbers, substeps, state)
        rows = partial(_in_rows, row=fluid.row)

        def describe() -> tuple[Neighbors, Tensor]:
            neighbor, offset = in_rows(fluid.row, lists.offset, lists.neighbor)
            described = np.empty((len(place), 14), np.float32)
            density_and_walls(
                place, *lists, walls.place, walls.volume, numbers.radius, numbers.height,
                numbers.volume, described,
            )  # fmt: skip
            particle = np.repeat(np.arange(len(place)), np.diff(offset))
            edges = Neighbors(*map(torch.from_numpy, (particle, neighbor, offset)))
            return edges, rows(described)

        return Outcome(
            state=particles.moved(rows(place), rows(velocity)),
            pressures=(rows(upkeep), rows(pressure)),
            rates=(rows(state.divergence), rows(state.left)),
            density=rows(state.density),
            surface=rows(state.surface),
            describe=describe,
        )

    def _solid_volumes(self, particles: Particles, solids: CellTable) -> NDArray[np.float32]:
        """Return the volumes of the solids, m³, in the order of their table."""
        radius, moving = particles.scene.support_radius, particles.solids_move
        height = spline_height(radius, particles.scene.dimension)

        def volumes(position: Tensor, frame: Tensor) -> NDArray[np.float32]:
            alone, none = CellTables()(_as_fluid(particles))
            volume = np.empty(len(alone.row), np.float32)
            solid_volumes(alone.place, near_lists(alone, none, radius), radius, height, volume)
            # Both tables sort the same particles, maybe into other cells.
            of_row = np.empty_like(volume)
            of_row[alone.row] = volume
            # Solids that move are in another order at each search.
            return of_row if moving else of_row[solids.row]

        found = self._volumes.get(
            (particles.solid_position, particles.solid_frame),
            (radius, particles.frames, moving),
            volumes,
        )
        return found[solids.row] if moving else found


def _as_fluid(particles: Particles) -> Particles:
    """Return the solid particles of a batch as if they were fluid."""
    position = particles.solid_position
    return Particles(
        position=position,
        velocity=particles.solid_velocity,
        frame=particles.solid_frame,
        solid_position=position[:0],
        solid_velocity=position[:0],
        solid_frame=particles.solid_frame[:0],
        frames=particles.frames,
        scene=particles.scene,
    )


def _in_rows(values: NDArray[np.float32], row: NDArray[np.int32]) -> Tensor:
    """Return sorted values (N, ...) in the rows of the particles."""
    rows = np.empty_like(values)
    rows[row] = values
    return torch.from_numpy(rows)


def _state(upkeep: NDArray[np.float32], pressure: NDArray[np.float32]) -> State:
    def empty(*shape: int) -> NDArray[np.float32]:
        return np.empty((len(pressure), *shape), np.float32)

    return State(
        middle=empty(3), density=empty(), surface=empty(3), divergence=empty(),
        left=empty(), divergence_pressure=upkeep, pressure=pressure,
    )  # fmt: skip
