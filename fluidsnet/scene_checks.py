"""Checks that one model can step frames of given scenes."""

from __future__ import annotations

import warnings
from typing import Any

from fluidsnet.errors import UserError
from fluidsnet.network import Network
from fluidsnet.periodic import is_periodic
from fluidsnet.priors import Prior
from fluidsnet.scene import Scene


def check_scenes(network: Network, prior: Prior, scenes: Scene) -> None:
    """Check that a network and its prior can step frames of all of these scenes.

    Warns of what the prior leaves out, and of values outside those of the training data.

    Args:
        network: Network.
        prior: Step that it corrects.
        scenes: Scenes.

    Raises:
        UserError: The global feature is bound to a grid, and the domains differ; a block does
            not know periodic axes; or the network was trained in another number of dimensions,
            or at another value of what did not vary.
    """
    _check_periodic(network, prior, scenes)
    for doubt in prior.doubts(scenes) if network.reads_guess else ():
        warnings.warn(doubt, stacklevel=3)
    if not network.target.width:
        _warn_of_unknown(prior, scenes)
        return
    feature = network.global_feature
    if feature.needs_its_grid:
        scenes.check_one_box(type(feature).__name__)
    if scenes.dimension != network.dimension:
        raise UserError(
            f"This network was trained in {network.dimension} dimensions, and "
            f"{scenes.names[0]} has {scenes.dimension}; train on such scenes."
        )
    network.scene_inputs.check(scenes)


def _check_periodic(network: Network, prior: Prior, scenes: Scene) -> None:
    if not is_periodic(scenes):
        return
    used: list[Any] = [network.global_feature] if network.target.width else []
    used += [prior] if network.reads_guess else []
    for block in used:
        if not block.knows_periodic:
            raise UserError(
                f"{scenes.names[0]} has periodic axes, which {type(block).__name__} does not "
                "know; use the paper's network (configs/model/paper.yaml), or the prior "
                "FreeFall without a VoxelField."
            )


def _warn_of_unknown(prior: Prior, scenes: Scene) -> None:
    """Warn of surface tension that a prior alone leaves out."""
    if "surface_tension" in prior.knows:
        return
    for name, value in zip(scenes.names, scenes.surface_tension.tolist(), strict=True):
        if value:
            warnings.warn(
                f"{name} has a surface tension of {value:g}, which the prior "
                f"{type(prior).__name__} leaves out.",
                stacklevel=4,
            )
            return
