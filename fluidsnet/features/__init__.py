"""What the network learns of a particle: from itself, its neighbors, and the whole scene."""

from fluidsnet.features.global_feature import GlobalFeature as GlobalFeature
from fluidsnet.features.global_feature import GlobalVector as GlobalVector
from fluidsnet.features.global_feature import NoGlobalFeature as NoGlobalFeature
from fluidsnet.features.input import InputFeature as InputFeature
from fluidsnet.features.kernel_messages import KernelMessages as KernelMessages
from fluidsnet.features.local import LocalFeature as LocalFeature
from fluidsnet.features.local import NeighborMean as NeighborMean
from fluidsnet.features.voxel import VoxelFeature as VoxelFeature
from fluidsnet.features.voxel_field import VoxelField as VoxelField
