"""Backends of the neighbor search."""

from fluidsnet.neighbors.auto import Auto as Auto
from fluidsnet.neighbors.brute import BruteForce as BruteForce
from fluidsnet.neighbors.cell_list import CellList as CellList
from fluidsnet.neighbors.cell_list_cpu import CellListCPU as CellListCPU
from fluidsnet.neighbors.search import Neighbors as Neighbors
from fluidsnet.neighbors.search import NeighborSearch as NeighborSearch
from fluidsnet.neighbors.torch_cluster import TorchCluster as TorchCluster
