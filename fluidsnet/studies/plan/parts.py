"""Parts of a model on a scene: built or left out, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from torch import nn

from fluidsnet.features.global_feature import GlobalVector
from fluidsnet.features.voxel import occupied_voxels
from fluidsnet.features.voxel_field import VoxelField
from fluidsnet.model import Model
from fluidsnet.particles import Particles
from fluidsnet.periodic import is_periodic, with_images
from fluidsnet.priors import PressureStep
from fluidsnet.scene import VALUES, Scene
from fluidsnet.walls import OpenWalls


@final
@dataclass(frozen=True)
class Part:
    """A part of a model.

    Attributes:
        name: What it is.
        why: Why it is built or left out, and its size.
        built: Whether it is built.
        weights: Number of its weights; None where it can have none.
        cost: Name of the costs that it causes, see `measure_costs`.
    """

    name: str
    why: str
    built: bool = True
    weights: int | None = None
    cost: str | None = None


def parts_of(model: Model, state: Particles, reached: int) -> list[Part]:
    """Return the parts of a model for a scene.

    Args:
        model: Model.
        state: Frame of the scene.
        reached: Number of solids within a support radius of the fluid.
    """
    network = model.network
    has_network = network.target.width > 0
    parts = [*_of_scene(model, state, reached)]
    name = type(model.prior).__name__
    if network.reads_guess:
        parts.append(Part("prior", f"{name}{_numbers(model)}", cost="prior"))
    else:
        parts.append(Part("prior", f"{name}: no block reads it", built=False))
    if not has_network:
        return [*parts, Part("network", "the model is its prior alone", built=False, weights=0)]
    own_search = not (network.reads_description and network.local.at_guess)
    neighbors = type(network.neighbors).__name__
    search = "the network takes the neighbors of its prior"
    if own_search:
        search = f"{neighbors}; its cost is in that of the local feature"
    feature = network.global_feature
    parts += [
        Part("neighbor search", search, built=own_search),
        Part(
            "input feature",
            f"{type(network.inputs).__name__}, {network.inputs.width} columns",
            weights=_weights(network.inputs),
            cost="inputs",
        ),
        Part(
            "local feature",
            f"{type(network.local).__name__}, {network.local.width} columns",
            weights=_weights(network.local),
            cost="local",
        ),
        Part(
            "global feature",
            f"{type(feature).__name__}{_levels(model, state)}",
            built=feature.width > 0,
            weights=_weights(feature),
            cost="global" if feature.width else None,
        ),
        Part(
            "head",
            f"{network.dimension} components of each of {network.target.width // 3} vector(s)",
            weights=_weights(network.head),
            cost="head",
        ),
    ]
    return parts


def _of_scene(model: Model, state: Particles, reached: int) -> Sequence[Part]:
    """Return the parts that depend on what the scene has."""
    scene, network = state.scene, model.network
    count = len(state.solid_position)
    flat = scene.dimension == 2
    axis = "three dimensions"
    if flat:
        axis = "two dimensions: no cells, walls and outputs along it, and the kernel of a plane"
    samples = f"{count:,} samples, {reached:,} of them near the fluid" if count else "none"
    motion = "they rest: sorted once" if count else "none"
    if state.solids_move:
        motion = "they move: sorted and carried in each search"
    found = [
        Part("third axis", axis, built=not flat),
        Part("solids", samples, built=count > 0),
        Part("motion of solids", motion, built=state.solids_move),
        _planes(model, scene),
    ]
    if is_periodic(scene):
        axes = ", ".join(axis for axis, on in zip("xyz", scene.periodic, strict=True) if on)
        images = len(with_images(state).solid_position) - count
        found.append(Part("periodic axes", f"{axes}: {images:,} images across the faces"))
    used = network.reads_guess
    for name in VALUES:
        label, varies = name.replace("_", " "), name in model.varying
        known = used and name in model.prior.knows
        if name in network.scene_inputs.names:
            found.append(Part(label, "varies between the simulations: an input of the network"))
        elif known:
            text = "varies between the simulations" if varies else "the same in all simulations"
            found.append(Part(label, f"{text}: the prior takes it as it is"))
        else:
            found.append(Part(label, "the same in all simulations: no input", built=False))
    return found


def _planes(model: Model, scene: Scene) -> Part:
    """Return the part of the walls that are planes of the domain."""
    number = 2 * scene.dimension
    if not isinstance(model.walls, OpenWalls):
        why = f"{type(model.walls).__name__} stops particles at the {number} planes of the domain"
    elif isinstance(model.prior, PressureStep) and model.network.reads_guess:
        why = f"the prior stops particles at the {number} planes of the domain"
    else:
        return Part("walls as planes", "the network learns walls from the samples", built=False)
    return Part("walls as planes", why)


def _levels(model: Model, state: Particles) -> str:
    """Return the cells of a global feature as text."""
    feature, shape = model.network.global_feature, model.network.grid_shape
    if isinstance(feature, GlobalVector):
        used = len(occupied_voxels(state, shape).cell)
        cells = " x ".join(map(str, shape))
        return f", {used:,} of {cells} cells hold particles, {len(feature.stack)} levels"
    if isinstance(feature, VoxelField):
        return ", only the cells around particles"
    return ""


def _numbers(model: Model) -> str:
    """Return the numbers of a pressure step as text."""
    prior = model.prior
    if not isinstance(prior, PressureStep):
        return ""
    phases = f"{prior.sweeps} sweeps over density"
    if prior.divergence_sweeps:
        phases += f" and {prior.divergence_sweeps} over divergence"
    else:
        phases += ", none over divergence"
    return f": {prior.searches} searches of {prior.substeps} substeps, {phases}"


def _weights(block: nn.Module) -> int:
    return sum(weight.numel() for weight in block.parameters())
