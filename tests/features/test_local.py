from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch

from fluidsnet.features import InputFeature, KernelMessages, NeighborMean
from fluidsnet.neighbors import BruteForce
from fluidsnet.particles import Particles

Make = Callable[..., Particles]


def test_neighbor_mean_against_a_loop(make_particles: Make) -> None:
    torch.manual_seed(0)
    particles = make_particles((120, 50), (60, 30))
    device = particles.position.device
    inputs, local = InputFeature().to(device), NeighborMean().to(device)
    inputs.velocity_deviation.fill_(0.5)
    found = local(particles, BruteForce()(particles), inputs)
    everyone = torch.cat([particles.position, particles.solid_position])
    velocity = torch.cat([particles.velocity, particles.solid_velocity])
    frame = torch.cat([particles.frame, particles.solid_frame])
    for row in range(len(particles)):
        distance = (everyone - everyone[row]).norm(dim=1)
        beside = (distance <= 0.2) & (frame == frame[row])
        beside[row] = False
        nearest = distance.masked_fill(~beside, torch.inf).argsort()[: min(32, int(beside.sum()))]
        edges = [
            torch.cat(
                [
                    (everyone[other] - everyone[row]) / 0.2,
                    velocity[other] / 0.5,
                    torch.tensor([float(other >= len(particles))], device=device),
                ]
            )
            for other in nearest
        ]
        expected = (
            local.edge(torch.stack(edges)).mean(dim=0) if edges else torch.zeros(9, device=device)
        )
        assert torch.allclose(found[row], expected, atol=1e-5), row


def test_a_particle_without_neighbors_gets_zeros(make_particles: Make) -> None:
    particles = make_particles((1, 0))
    local = NeighborMean().to(particles.position.device)
    found = local(particles, BruteForce()(particles), InputFeature())
    assert torch.equal(found, torch.zeros_like(found))


def test_messages_fade_before_a_neighbor_is_lost(make_particles: Make) -> None:
    torch.manual_seed(0)
    particles = make_particles((2, 0))
    device = particles.position.device
    inputs, messages = InputFeature().to(device), KernelMessages().to(device)

    def feature(distance: float) -> torch.Tensor:
        position = torch.tensor([[0.5, 0.5, 0.5], [0.5 + distance, 0.5, 0.5]], device=device)
        state = replace(particles, position=position)
        return messages(state, BruteForce()(state), inputs)

    # At the support radius of 0.2 the neighbor goes; the feature does not jump.
    assert torch.allclose(feature(0.1999), feature(0.2001), atol=1e-5)
    assert not torch.allclose(feature(0.1), feature(0.2001), atol=1e-2)


def test_messages_tell_a_dense_neighborhood_from_a_thin_one(make_particles: Make) -> None:
    torch.manual_seed(0)
    particles = make_particles((3, 0))
    device = particles.position.device
    inputs, messages = InputFeature().to(device), KernelMessages(rounds=1).to(device)
    mean = NeighborMean().to(device)
    thin = particles.moved(
        torch.tensor([[0.5, 0.5, 0.5], [0.6, 0.5, 0.5], [1.4, 0.5, 0.5]], device=device),
        torch.zeros(3, 3, device=device),
    )
    dense = thin.moved(
        torch.tensor([[0.5, 0.5, 0.5], [0.6, 0.5, 0.5], [0.6, 0.5, 0.5]], device=device),
        thin.velocity,
    )
    states = [(state, BruteForce()(state), inputs) for state in (thin, dense)]
    heard = [messages(*state)[0] for state in states]
    assert not torch.allclose(heard[0], heard[1], atol=1e-3)
    averaged = [mean(*state)[0] for state in states]
    assert torch.allclose(averaged[0], averaged[1], atol=1e-6)


def test_inputs_are_normalized_by_the_scene(make_particles: Make) -> None:
    particles = make_particles((2, 0))
    device = particles.position.device
    corners = torch.stack([particles.scene.domain_lower, particles.scene.domain_upper])
    inputs = InputFeature().to(device)
    inputs.velocity_deviation.fill_(4.0)
    found = inputs(particles.moved(corners, torch.full((2, 3), 2.0, device=device)))
    expected = [[-1.0] * 3 + [0.5] * 3 + [0.0], [1.0] * 3 + [0.5] * 3 + [0.0]]
    assert torch.allclose(found, torch.tensor(expected, device=device))
