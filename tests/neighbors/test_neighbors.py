"""Every backend, over the same cases, against every pair of particles compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from fluidsnet.cache import TensorCache
from fluidsnet.neighbors import (
    Auto,
    BruteForce,
    CellList,
    CellListCPU,
    Neighbors,
    NeighborSearch,
    TorchCluster,
)
from fluidsnet.particles import Particles
from fluidsnet.scene import Scene

RADIUS = 0.1
K = 8


def _few_pairs(k: int = 32) -> NeighborSearch:
    return CellList(k, pairs=50)


BACKENDS: list[Callable[[int], NeighborSearch]] = [
    Auto,
    CellList,
    _few_pairs,
    CellListCPU,
    TorchCluster,
]


def _scene(radius: float = RADIUS) -> Scene:
    return Scene.single(
        domain_lower=(0.0, 0.0, 0.0),
        domain_upper=(1.0, 1.0, 1.0),
        gravity=(0.0, -9.81, 0.0),
        particle_radius=radius / 4,
        support_radius=radius,
        time_step=0.02,
    )


def _particles(
    fluid: list[Tensor], solid: list[Tensor] | None = None, radius: float = RADIUS
) -> Particles:
    """A batch from the fluid (N, 3) and solid (M, 3) positions of each frame, m."""
    solid = [torch.zeros(0, 3)] * len(fluid) if solid is None else solid
    return Particles.collate(
        [
            Particles.single(position, torch.zeros_like(position), around, _scene(radius))
            for position, around in zip(fluid, solid, strict=True)
        ]
    )


def _random(*count: int, seed: int = 0, scale: float = 0.5) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [scale * torch.rand(n, 3, generator=generator) for n in count]


def _lattice(count: int, spacing: float) -> Tensor:
    axis = torch.arange(count) * spacing
    return torch.cartesian_prod(axis, axis, axis)


def _frames() -> Particles:
    return _particles(_random(300, 0, 200, 1, 0), _random(100, 50, 0, 100, 0, seed=1))


def _duplicates() -> Particles:
    place = torch.tensor([[0.3, 0.3, 0.3]])
    fluid = torch.cat([place.expand(3 * K, 3), *_random(100)])
    return _particles([fluid], [place.expand(2 * K, 3)])


def _on_the_radius() -> Particles:
    # Quarters are exact in binary, and so is their distance.
    axis = torch.tensor([-0.25, 0.0, 0.25, 0.5])
    return _particles([torch.cartesian_prod(axis, axis[:1], axis[:1])], radius=0.25)


def _beyond_the_radius() -> Particles:
    beyond = torch.nextafter(torch.tensor(0.25), torch.tensor(1.0)).item()
    return _particles([torch.tensor([[0.0, 0.0, 0.0], [beyond, 0.0, 0.0]])], radius=0.25)


def _far_away() -> Particles:
    near = torch.cat([*_random(300), *_random(50, seed=1, scale=-0.3)])
    far = [
        torch.tensor([[x, y, z], [x, y, z]])
        for x, y, z in [
            (1e3, 0.0, 0.0),
            (0.0, -1e6, 0.0),
            (0.0, 0.0, 1e12),
            (-1e30, 1e30, -1e30),
            (3e38, 3e38, 3e38),
        ]
    ]
    # Neighbors far out, where cells repeat and floats have gaps.
    pairs = torch.tensor([[5e4, 5e4, -5e4], [5e4 + 0.0625, 5e4, -5e4], [-5e4, 3e4, 0.0]])
    return _particles([torch.cat([near, *far, pairs])], [torch.cat([*_random(60, seed=2), *far])])


def _exploded() -> Particles:
    generator = torch.Generator().manual_seed(0)
    direction = torch.randn(400, 3, generator=generator)
    return _particles([direction * 10 ** (12 * torch.rand(400, 1, generator=generator) - 3)])


def _not_finite() -> Particles:
    fluid, solid = _random(200, 50)
    fluid[3, 0], fluid[77, 1], fluid[150] = torch.nan, torch.inf, -torch.inf
    solid[7, 2], solid[8] = torch.nan, torch.inf
    return _particles([fluid], [solid])


CASES: dict[str, Callable[[], Particles]] = {
    "frames": _frames,
    "dense": lambda: _particles(_random(400, scale=0.2), _random(200, seed=1, scale=0.2)),
    "negative": lambda: _particles([_random(300)[0] - 0.25], [_random(80, seed=1)[0] - 0.4]),
    "elongated": lambda: _particles([_random(400)[0] * torch.tensor([40.0, 0.3, 0.1])]),
    "outside": lambda: _particles([_random(300)[0] + 7.0], [_random(80, seed=1)[0] + 7.1]),
    "lattice": lambda: _particles([_lattice(6, 0.05)], [_lattice(4, 0.05) + 0.125]),
    "exact lattice": lambda: _particles([_lattice(6, 0.125)], radius=0.25),
    "duplicates": _duplicates,
    "on the radius": _on_the_radius,
    "beyond the radius": _beyond_the_radius,
    "far away": _far_away,
    "exploded": _exploded,
    "not finite": _not_finite,
    "nothing finite": lambda: _particles([torch.full((5, 3), torch.nan)]),
    "one": lambda: _particles([torch.zeros(1, 3)]),
    "one and a solid": lambda: _particles([torch.zeros(1, 3)], [torch.full((1, 3), 0.01)]),
    "no fluid": lambda: _particles([torch.zeros(0, 3)], _random(20)),
    "nothing": lambda: _particles([torch.zeros(0, 3)]),
    "fewer than k": lambda: _particles(_random(K - 2, 3, scale=0.05), _random(1, 0, seed=1)),
}
# torch-cluster sorts what is not finite anywhere in its tree.
UNSORTABLE = {"not finite", "nothing finite"}


def _distances(neighbors: Neighbors, particles: Particles) -> Tensor:
    everyone = torch.cat([particles.position, particles.solid_position])
    offset = everyone[neighbors.neighbor] - particles.position[neighbors.particle]
    return offset.square().sum(dim=-1)


def _check(found: Neighbors, particles: Particles, k: int, ties: bool) -> None:
    """Compares all of what was found; with ties, only how far the neighbors are."""
    expected = BruteForce(k)(particles)
    for tensor in (found.particle, found.neighbor, found.offset):
        assert tensor.dtype == torch.int64
        assert tensor.device == particles.position.device
    assert torch.equal(found.offset, expected.offset)
    assert torch.equal(found.particle, expected.particle)
    if ties:
        assert torch.equal(_distances(found, particles), _distances(expected, particles))
        edges = zip(found.particle.tolist(), found.neighbor.tolist(), strict=True)
        assert len(set(edges)) == len(found.particle)
        assert not (found.particle == found.neighbor).any()
    else:
        assert torch.equal(found.neighbor, expected.neighbor)


@pytest.mark.parametrize("k", [1, K, 40])
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("backend", BACKENDS)
def test_agrees_with_every_pair(
    backend: Callable[[int], NeighborSearch], case: str, k: int, device: torch.device
) -> None:
    if backend is TorchCluster and case in UNSORTABLE:
        pytest.skip("torch-cluster takes finite positions")
    particles = CASES[case]().to(device)
    _check(backend(k)(particles), particles, k, ties=backend is TorchCluster)


@pytest.mark.parametrize(
    ("case", "tied"), [("exact lattice", True), ("duplicates", True), ("dense", False)]
)
def test_cases_have_what_they_are_for(case: str, tied: bool) -> None:
    particles = CASES[case]()
    everyone = BruteForce(10**6)(particles)
    squared = _distances(everyone, particles)
    last = everyone.offset[:-1][everyone.offset.diff() > K] + K - 1
    assert len(last) > 0
    assert (squared[last] == squared[last + 1]).any() == tied


def test_the_reference_keeps_the_rule() -> None:
    at = torch.tensor([[0.0, 0, 0], [0.0625, 0, 0], [-0.0625, 0, 0], [0.0, 0.25, 0], [0.0, 0, 0.5]])
    particles = _particles([at, at[:1]], [at[:1], torch.zeros(0, 3)], radius=0.25)
    neighbors = BruteForce(3)(particles)
    # Row 6 is the solid at the first particle's place, 5 the other frame's particle.
    assert neighbors.neighbor[:3].tolist() == [6, 1, 2]
    assert neighbors.offset.tolist() == [0, 3, 6, 9, 11, 11, 11]


@pytest.mark.parametrize("backend", BACKENDS)
def test_solids_are_kept_only_while_they_rest(
    backend: Callable[[int], NeighborSearch], device: torch.device
) -> None:
    search = backend(K)
    particles = _frames().to(device)
    for step in range(3):
        position = particles.position + 0.02 * step
        moved = particles.moved(position, particles.velocity)
        _check(search(moved), moved, K, ties=backend is TorchCluster)
    particles.solid_position.mul_(0.7).add_(0.1)
    _check(search(particles), particles, K, ties=backend is TorchCluster)
    particles.solid_frame.copy_(particles.solid_frame.flip(0).sort().values)
    fewer = replace(
        particles,
        solid_position=particles.solid_position[:40],
        solid_frame=particles.solid_frame[:40],
    )
    _check(search(fewer), fewer, K, ties=backend is TorchCluster)
    wider = replace(particles, scene=_scene(0.17).to(device))
    _check(search(wider), wider, K, ties=backend is TorchCluster)
    _check(search(particles), particles, K, ties=backend is TorchCluster)


@pytest.mark.parametrize("backend", BACKENDS)
def test_solids_changed_where_no_version_tells(backend: Callable[[int], NeighborSearch]) -> None:
    search = backend(K)
    with torch.inference_mode():
        particles = _frames()
        search(particles)
        particles.solid_position.mul_(0.7)
        _check(search(particles), particles, K, ties=backend is TorchCluster)


@pytest.mark.parametrize("backend", [Auto, CellList, CellListCPU])
def test_resting_solids_are_sorted_once(
    backend: Callable[[int], NeighborSearch], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = 0
    genuine = TensorCache.get

    def counting(self, tensors, settings, make):  # type: ignore[no-untyped-def]
        def counted(*given: Tensor) -> object:
            nonlocal made
            made += 1
            return make(*given)

        return genuine(self, tensors, settings, counted)

    monkeypatch.setattr(TensorCache, "get", counting)
    search = backend(K)
    particles = _frames()
    for _ in range(3):
        search(particles)
    assert made == 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_differentiable_and_strided_positions(
    backend: Callable[[int], NeighborSearch], device: torch.device
) -> None:
    particles = _frames().to(device)
    position = torch.cat([particles.position, particles.position], dim=1)[:, :3].requires_grad_()
    given = particles.moved(position, particles.velocity)
    found = backend(K)(given)
    _check(found, particles, K, ties=backend is TorchCluster)


@pytest.mark.parametrize("backend", [CellList, CellListCPU])
def test_many_at_one_place_fit_in_memory(backend: Callable[[int], NeighborSearch]) -> None:
    particles = _particles([torch.zeros(1500, 3)], [torch.zeros(700, 3)])
    _check(backend(K)(particles), particles, K, ties=False)


@pytest.mark.parametrize("backend", BACKENDS)
def test_k_is_one_at_least(backend: Callable[[int], NeighborSearch]) -> None:
    with pytest.raises(ValueError, match="k is 0"):
        backend(0)
