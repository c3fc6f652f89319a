from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import pytest
import torch
from outputs import output_of
from torch.overrides import TorchFunctionMode

from fluidsnet.features import (
    GlobalVector,
    KernelMessages,
    NeighborMean,
    NoGlobalFeature,
    ParticleState,
    VoxelField,
)
from fluidsnet.neighbors import BruteForce, TorchCluster
from fluidsnet.network import Network
from fluidsnet.particles import Particles
from fluidsnet.scene import Scene
from fluidsnet.target import AccelerationTarget, DisplacementTarget, VelocityTarget

CELLS = (6, 4, 6)
Make = Callable[..., Particles]

NETWORKS: dict[str, Callable[[], Network]] = {
    "paper": lambda: Network(
        CELLS, TorchCluster(), ParticleState(), NeighborMean(), GlobalVector, VelocityTarget()
    ),
    "no context": lambda: Network(
        CELLS,
        TorchCluster(),
        ParticleState(),
        NeighborMean(),
        NoGlobalFeature,
        AccelerationTarget(),
    ),
    "field": lambda: Network(
        CELLS,
        TorchCluster(),
        ParticleState(),
        KernelMessages(),
        VoxelField,
        DisplacementTarget(),
        head=(64,),
    ),
}


@pytest.fixture(params=NETWORKS)
def network(request: pytest.FixtureRequest, device: torch.device) -> Network:
    torch.manual_seed(0)
    return NETWORKS[request.param]().to(device)


def shifted(particles: Particles, by: torch.Tensor) -> Particles:
    scene = particles.scene
    return replace(
        particles,
        position=particles.position + by,
        solid_position=particles.solid_position + by,
        scene=replace(
            scene, domain_lower=scene.domain_lower + by, domain_upper=scene.domain_upper + by
        ),
    )


def test_permuted_particles_permute_the_output(network: Network, make_particles: Make) -> None:
    particles = make_particles((200, 80))
    order = torch.randperm(200, device=particles.position.device)
    permuted = replace(
        particles, position=particles.position[order], velocity=particles.velocity[order]
    )
    network.eval()
    assert torch.allclose(
        output_of(network, permuted), output_of(network, particles)[order], atol=1e-5
    )


def test_a_scene_moved_with_its_domain_gives_the_same(
    network: Network, make_particles: Make
) -> None:
    # A power of two, so that the move itself does not round the offsets.
    particles = make_particles((200, 80))
    particles = replace(
        particles,
        position=(particles.position * 1024).round() / 1024,
        solid_position=(particles.solid_position * 1024).round() / 1024,
    )
    by = torch.tensor([4.0, -2.0, 8.0], device=particles.position.device)
    network.eval()
    assert torch.allclose(
        output_of(network, shifted(particles, by)), output_of(network, particles), atol=1e-5
    )


def test_a_scaled_scene_looks_alike(network: Network, make_particles: Make) -> None:
    if isinstance(network.target, DisplacementTarget):
        pytest.skip("free fall has a scale of its own; the features alone are compared")
    particles = make_particles((200, 80))
    scene = particles.scene
    larger = replace(
        particles,
        position=2 * particles.position,
        solid_position=2 * particles.solid_position,
        scene=replace(
            scene,
            domain_upper=2 * scene.domain_upper,
            particle_radius=2 * scene.particle_radius,
            support_radius=2 * scene.support_radius,
        ),
    )
    network.eval()
    assert torch.allclose(output_of(network, larger), output_of(network, particles), atol=1e-5)


def test_a_batch_gives_what_its_frames_give(network: Network, make_particles: Make) -> None:
    network.eval()
    counts = ((120, 40), (1, 0), (77, 60))
    batch = output_of(network, make_particles(*counts))
    alone = [output_of(network, frame) for frame in _frames(make_particles(*counts))]
    assert torch.allclose(batch, torch.cat(alone), atol=1e-5)


def _frames(batch: Particles) -> list[Particles]:
    return [
        Particles.single(
            batch.position[batch.frame == number],
            batch.velocity[batch.frame == number],
            batch.solid_position[batch.solid_frame == number],
            _scene_of(batch.scene, number),
        )
        for number in range(batch.frames)
    ]


def _scene_of(scene: Scene, frame: int) -> Scene:
    values = {field.name: getattr(scene, field.name) for field in fields(scene)}
    per_frame = {name for name, value in values.items() if not isinstance(value, int | float)}
    return replace(scene, **{name: values[name][frame : frame + 1] for name in per_frame})


@pytest.mark.parametrize("training", [False, True])
@pytest.mark.parametrize("counts", [(1, 0), (1, 5), (2, 0), (40, 0), (300, 100)])
def test_few_particles_and_no_solids(
    network: Network, make_particles: Make, counts: tuple[int, int], training: bool
) -> None:
    network.train(training)
    output = output_of(network, make_particles(counts))
    assert output.shape == (counts[0], network.target.width)
    assert output.isfinite().all()


def test_no_particle_at_all(network: Network, make_particles: Make) -> None:
    network.eval()
    assert output_of(network, make_particles((0, 10))).shape == (0, network.target.width)


def test_all_particles_in_one_voxel_and_at_one_point(
    network: Network, make_particles: Make
) -> None:
    particles = make_particles((50, 10))
    crowded = particles.moved(
        particles.position[:1] + 1e-4 * particles.position, particles.velocity
    )
    together = particles.moved(particles.position[:1].expand(50, 3), particles.velocity)
    for state in (crowded, together):
        assert output_of(network, state).isfinite().all()


def test_particles_outside_the_domain(network: Network, make_particles: Make) -> None:
    particles = make_particles((50, 10))
    outside = particles.moved(100 * (particles.position - 0.5), particles.velocity)
    assert output_of(network, outside).isfinite().all()


def test_gradients_reach_every_weight(network: Network, make_particles: Make) -> None:
    output_of(network, make_particles((150, 60), (90, 60))).square().mean().backward()
    for name, weight in network.named_parameters():
        assert weight.grad is not None and weight.grad.abs().sum() > 0, name


class DevicesAreNamed(TorchFunctionMode):
    """Refuses to make a tensor from nothing without saying on which device."""

    factories = frozenset(
        getattr(torch, name)
        for name in (
            "arange", "empty", "eye", "full", "linspace", "logspace", "ones", "rand", "randint",
            "randn", "randperm", "tensor", "as_tensor", "zeros",
        )
    )  # fmt: skip

    def __torch_function__(
        self, function: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        kwargs = kwargs or {}
        assert function not in self.factories or "device" in kwargs, (
            f"{function.__name__} was called without a device"
        )
        return function(*args, **kwargs)


def test_no_tensor_is_made_without_a_device(network: Network, make_particles: Make) -> None:
    particles = make_particles((150, 60), (90, 60))
    with DevicesAreNamed():
        output_of(network, particles).square().mean().backward()
        network.eval()
        output_of(network, particles)
    with pytest.raises(AssertionError, match="zeros"), DevicesAreNamed():
        torch.zeros(3)


def test_the_neighbor_search_does_not_matter(make_particles: Make, device: torch.device) -> None:
    network = NETWORKS["paper"]().to(device).eval()
    particles = make_particles((300, 100), (200, 50))
    expected = output_of(network, particles)
    network.neighbors = BruteForce()
    assert torch.allclose(output_of(network, particles), expected, atol=1e-5)
