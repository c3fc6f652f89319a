"""Exact neighbors on the CPU: a cell list in numba."""

from __future__ import annotations

from typing import final

from fluidsnet.kernels.cell_table import CellTables
from fluidsnet.kernels.search import nearest_neighbors
from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles


@final
class CellListCPU(NeighborSearch):
    """Cell list in numba: exact, of linear cost, on as many threads as torch has.

    Particles are sorted into cells as wide as the support radius, and candidates come from the
    27 cells around each. Fluid and solids have separate tables; that of the solids is kept
    while they rest. Memory grows with the number of particles alone, wherever they are.
    Distances are compared in float32. Particles on another device are copied back and forth.
    The first call on a machine compiles for about 15 s; the result is cached on disk.

    Args:
        k: Maximum number of neighbors of a particle.
    """

    def __init__(self, k: int = 32) -> None:
        super().__init__(k)
        #: Cell tables of a batch.
        self.tables = CellTables()

    def __call__(self, particles: Particles) -> Neighbors:
        fluid, solids = self.tables(particles)
        edges = nearest_neighbors(fluid, solids, particles.scene.support_radius, self.k)
        return Neighbors(*(values.to(particles.position.device) for values in edges))
