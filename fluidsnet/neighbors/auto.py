"""Backend that measured fastest for a device."""

from __future__ import annotations

from typing import final

import torch

from fluidsnet.neighbors.cell_list import CellList
from fluidsnet.neighbors.cell_list_cpu import CellListCPU
from fluidsnet.neighbors.search import Neighbors, NeighborSearch
from fluidsnet.particles import Particles


@final
class Auto(NeighborSearch):
    """`CellListCPU` on the CPU, `CellList` on other devices.

    On two cores `CellListCPU` was faster than `TorchCluster` at every size: 3 times for 50
    particles, 10 times for 5,000 and 16 to 49 times for 618,075, depending on the order of the
    rows. Nothing was measured on a GPU, where the quadratic search of `TorchCluster` may be
    faster for few particles.

    Args:
        k: Maximum number of neighbors of a particle.
    """

    def __init__(self, k: int = 32) -> None:
        super().__init__(k)
        self._cpu, self._other = CellListCPU(k), CellList(k)

    def backend(self, device: torch.device) -> NeighborSearch:
        """Return the backend for a device."""
        return self._cpu if device.type == "cpu" else self._other

    def __call__(self, particles: Particles) -> Neighbors:
        return self.backend(particles.position.device)(particles)
