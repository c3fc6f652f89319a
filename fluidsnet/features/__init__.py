"""What the network learns of a particle: from itself, its neighbors, and the whole scene."""

from fluidsnet.features.context import Context as Context
from fluidsnet.features.context import GlobalVector as GlobalVector
from fluidsnet.features.context import NoContext as NoContext
from fluidsnet.features.field import VoxelField as VoxelField
from fluidsnet.features.input import InputFeature as InputFeature
from fluidsnet.features.local import LocalFeature as LocalFeature
from fluidsnet.features.local import NeighborMean as NeighborMean
from fluidsnet.features.messages import KernelMessages as KernelMessages
from fluidsnet.features.voxel import VoxelFeature as VoxelFeature
