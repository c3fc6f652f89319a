from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import final

import pytest
import torch
from torch import Tensor

import fluidsnet.features
from fluidsnet.errors import UserError
from fluidsnet.features import (
    GlobalFeature,
    GlobalVector,
    InputFeature,
    KernelMessages,
    LocalFeature,
    NeighborMean,
    NoGlobalFeature,
    ParticleState,
)
from fluidsnet.kernels import disabled
from fluidsnet.model import Model
from fluidsnet.neighbors import Auto, BruteForce
from fluidsnet.network import Network
from fluidsnet.particles import Particles, Transitions
from fluidsnet.priors import FreeFall, Guess
from fluidsnet.statistics import Statistics
from fluidsnet.target import VelocityTarget

Make = Callable[..., Particles]
#: Columns of the input feature, which these local features do not read.
NO_COLUMNS = torch.empty(0)


def test_neighbor_mean_against_a_loop(make_particles: Make) -> None:
    torch.manual_seed(0)
    particles = make_particles((120, 50), (60, 30))
    device = particles.position.device
    inputs, local = ParticleState().to(device), NeighborMean().to(device)
    inputs.velocity_deviation.fill_(0.5)
    found = local(particles, BruteForce()(particles), inputs, NO_COLUMNS)
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
    found = local(particles, BruteForce()(particles), ParticleState(), NO_COLUMNS)
    assert torch.equal(found, torch.zeros_like(found))


def test_messages_fade_before_a_neighbor_is_lost(make_particles: Make) -> None:
    torch.manual_seed(0)
    particles = make_particles((2, 0))
    device = particles.position.device
    inputs, messages = ParticleState().to(device), KernelMessages().to(device)

    def feature(distance: float) -> torch.Tensor:
        position = torch.tensor([[0.5, 0.5, 0.5], [0.5 + distance, 0.5, 0.5]], device=device)
        state = replace(particles, position=position)
        return messages(state, BruteForce()(state), inputs, NO_COLUMNS)

    # At the support radius of 0.2 the neighbor goes; the feature does not jump.
    assert torch.allclose(feature(0.1999), feature(0.2001), atol=1e-5)
    assert not torch.allclose(feature(0.1), feature(0.2001), atol=1e-2)


def test_messages_tell_a_dense_neighborhood_from_a_thin_one(make_particles: Make) -> None:
    torch.manual_seed(0)
    particles = make_particles((3, 0))
    device = particles.position.device
    inputs, messages = ParticleState().to(device), KernelMessages(rounds=1).to(device)
    mean = NeighborMean().to(device)
    thin = particles.moved(
        torch.tensor([[0.5, 0.5, 0.5], [0.6, 0.5, 0.5], [1.4, 0.5, 0.5]], device=device),
        torch.zeros(3, 3, device=device),
    )
    dense = thin.moved(
        torch.tensor([[0.5, 0.5, 0.5], [0.6, 0.5, 0.5], [0.6, 0.5, 0.5]], device=device),
        thin.velocity,
    )
    states = [(state, BruteForce()(state), inputs, NO_COLUMNS) for state in (thin, dense)]
    heard = [messages(*state)[0] for state in states]
    assert not torch.allclose(heard[0], heard[1], atol=1e-3)
    averaged = [mean(*state)[0] for state in states]
    assert torch.allclose(averaged[0], averaged[1], atol=1e-6)


def test_inputs_are_normalized_by_the_scene(make_particles: Make) -> None:
    particles = make_particles((2, 0))
    device = particles.position.device
    corners = torch.cat([particles.scene.domain_lower, particles.scene.domain_upper])
    inputs = ParticleState().to(device)
    inputs.velocity_deviation.fill_(4.0)
    at_corners = particles.moved(corners, torch.full((2, 3), 2.0, device=device))
    found = inputs(at_corners, FreeFall()(at_corners))
    expected = [[-1.0] * 3 + [0.5] * 3 + [0.0], [1.0] * 3 + [0.5] * 3 + [0.0]]
    assert torch.allclose(found, torch.tensor(expected, device=device))


def test_the_compiled_gradients_are_torchs(make_particles: Make, device: torch.device) -> None:
    # More than a chunk of particles, some of them alone.
    particles = make_particles((700, 200), (30, 0), (1, 0))
    neighbors = BruteForce(k=7)(particles)
    inputs, local = ParticleState().to(device), NeighborMean(hidden=5, width=6).to(device)
    weight = torch.randn(len(particles), 6, device=device)
    found = local(particles, neighbors, inputs, NO_COLUMNS)
    (found * weight).sum().backward()
    gradients = [parameter.grad.clone() for parameter in local.parameters()]
    local.zero_grad()
    # Positions that want a gradient go through torch alone.
    watched = particles.moved(particles.position.clone().requires_grad_(), particles.velocity)
    expected = local(watched, neighbors, inputs, NO_COLUMNS)
    (expected * weight).sum().backward()
    assert watched.position.grad is not None
    assert torch.allclose(found, expected, atol=2e-6)
    for parameter, gradient in zip(local.parameters(), gradients, strict=True):
        assert torch.allclose(gradient, parameter.grad, rtol=1e-4, atol=1e-4)


def test_kernels_can_be_disabled(make_particles: Make) -> None:
    torch.manual_seed(0)
    particles = make_particles((300, 100))
    model = Model((6, 4, 6), neighbors=BruteForce()).to(particles.position.device).eval()
    with torch.no_grad():
        found = model.step(particles)
        with disabled():
            expected = model.step(particles)
    with torch.enable_grad():
        # Positions that need a gradient have no kernel.
        position = particles.position.clone().requires_grad_()
        plain = model.step(particles.moved(position, particles.velocity))
    assert torch.equal(expected.velocity, plain.velocity)
    assert torch.allclose(found.velocity, expected.velocity, atol=1e-5)


@final
class SpeedAndHeight(InputFeature):
    """Other columns than the default: height, speed; a neighbor sends velocity and height."""

    width = 2
    sent_width = 5
    relative_width = 4

    def set_statistics(self, statistics: Statistics) -> None:
        pass

    def forward(self, particles: Particles, guess: Guess) -> Tensor:
        height, velocity = particles.position[:, 1:2], particles.velocity
        return torch.cat([height, velocity.norm(dim=1, keepdim=True)], dim=1)

    def sent(self, particles: Particles) -> Tensor:
        position = torch.cat([particles.position, particles.solid_position])
        velocity = torch.cat([particles.velocity, particles.solid_velocity])
        speed = velocity.norm(dim=1, keepdim=True)
        return torch.cat([velocity, speed, position[:, 1:2]], dim=1)


LOCAL_FEATURES: dict[str, Callable[[], LocalFeature]] = {
    "mean": lambda: NeighborMean(sent_width=5),
    "messages": lambda: KernelMessages(sent_width=5, relative_width=4),
}


@pytest.mark.parametrize("name", LOCAL_FEATURES)
def test_an_input_feature_of_other_columns_trains(name: str, make_particles: Make) -> None:
    torch.manual_seed(0)
    state, later = make_particles((300, 100)), make_particles((300, 100), seed=1)
    model = Model((6, 4, 6), inputs=SpeedAndHeight(), local=LOCAL_FEATURES[name]())
    model.to(state.position.device)
    batch = Transitions(
        state, later.position[None], later.velocity[None], torch.zeros(1, dtype=torch.int64)
    )
    optimizer = torch.optim.Adam(model.parameters(), lr=0.01)
    losses = []
    for _ in range(5):
        optimizer.zero_grad()
        loss = model.loss(batch)
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert all(weight.grad.abs().sum() > 0 for weight in model.network.local.parameters())
    assert losses[-1] < losses[0]
    model.eval()
    expected = model.step(state)
    with torch.no_grad():
        assert torch.allclose(model.step(state).velocity, expected.velocity, atol=1e-5)


@pytest.mark.parametrize("local", [NeighborMean(), KernelMessages(sent_width=5)])
def test_columns_must_agree(local: LocalFeature) -> None:
    with pytest.raises(UserError, match=r"set local\.init_args\.(sent|relative)_width to (5|4)"):
        Network((6, 4, 6), Auto(), SpeedAndHeight(), local, GlobalVector, VelocityTarget())


def test_earlier_names_still_import() -> None:
    for earlier, now in (("NoContext", NoGlobalFeature), ("Context", GlobalFeature)):
        with pytest.warns(DeprecationWarning, match=f"use fluidsnet.features.{now.__name__}"):
            assert getattr(fluidsnet.features, earlier) is now
    assert not hasattr(fluidsnet.features, "NoVector")
