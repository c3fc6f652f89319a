"""Features of a particle: its own state, its neighborhood, and the whole scene."""

import warnings
from typing import Any

from fluidsnet.features.continuous_convolutions import (
    ContinuousConvolutions as ContinuousConvolutions,
)
from fluidsnet.features.global_feature import GlobalFeature as GlobalFeature
from fluidsnet.features.global_feature import GlobalVector as GlobalVector
from fluidsnet.features.global_feature import NoGlobalFeature as NoGlobalFeature
from fluidsnet.features.input import InputFeature as InputFeature
from fluidsnet.features.input import ParticleState as ParticleState
from fluidsnet.features.kernel_messages import KernelMessages as KernelMessages
from fluidsnet.features.local import LocalFeature as LocalFeature
from fluidsnet.features.local import NeighborMean as NeighborMean
from fluidsnet.features.prior_state import PriorState as PriorState
from fluidsnet.features.voxel import VoxelFeature as VoxelFeature
from fluidsnet.features.voxel_field import VoxelField as VoxelField

_RENAMED = {"Context": "GlobalFeature", "NoContext": "NoGlobalFeature"}


def __getattr__(name: str) -> Any:
    """Return the class of an earlier name, which old checkpoints and configs still have."""
    if name not in _RENAMED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    new = _RENAMED[name]
    message = f"{__name__}.{name} was renamed; use {__name__}.{new}."
    warnings.warn(message, DeprecationWarning, stacklevel=2)
    return globals()[new]
