"""Neighbor search and local feature in one kernel, where both have one."""

from __future__ import annotations

from torch import Tensor
from torch.profiler import record_function

from fluidsnet.features.input import FLUID, SOLID, InputFeature, ParticleState
from fluidsnet.features.local import LocalFeature, NeighborMean
from fluidsnet.features.perceptron import linear_layers
from fluidsnet.kernels import use_kernel
from fluidsnet.kernels.columns import as_array, padded
from fluidsnet.kernels.fused_edge_mean import EdgeLayers, fused_edge_mean
from fluidsnet.neighbors import Auto, CellListCPU, NeighborSearch
from fluidsnet.particles import Particles


def fused_local(
    particles: Particles, search: NeighborSearch, local: LocalFeature, inputs: InputFeature
) -> Tensor | None:
    """Return ``local(particles, search(particles), inputs)`` without storing an edge.

    Returns:
        (N, local.width); None where these blocks, the device or the dtype have no such kernel,
        or gradients are needed.
    """
    if isinstance(search, Auto):
        search = search.backend(particles.position.device)
    state = (
        particles.position,
        particles.velocity,
        particles.solid_position,
        particles.solid_velocity,
    )
    if not (
        isinstance(search, CellListCPU)
        and isinstance(local, NeighborMean)
        and isinstance(inputs, ParticleState)
        and use_kernel(local, *state)
        # Its marker is that of fluid or solid rows.
        and particles.fluid_image is None
    ):
        return None
    with record_function("sort"):
        tables = search.tables(particles)
    (weight, bias), (second_weight, second_bias) = linear_layers(local.edge)
    radius, marker = particles.scene.support_radius, weight[:, 6]
    layers = EdgeLayers(
        # At a radius of zero all neighbors are at the same place, and offsets are zero.
        offset=as_array(weight[:, :3] / radius if radius else 0 * weight[:, :3]),
        velocity=as_array(weight[:, 3:6] / inputs.velocity_deviation),
        fluid=as_array(bias + FLUID * marker),
        solid=as_array(bias + SOLID * marker),
        weight=padded(second_weight),
        bias=as_array(second_bias),
    )
    with record_function("search + local"):
        return fused_edge_mean(particles, tables, layers, search.k)
