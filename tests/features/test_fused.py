from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from outputs import output_of
from torch import Tensor, nn
from torch_scatter import scatter

from datamodules.reader import FrameReader
from fluidsnet.features import (
    GlobalVector,
    KernelMessages,
    NeighborMean,
    ParticleState,
    VoxelFeature,
)
from fluidsnet.features.fused_local import fused_local
from fluidsnet.features.perceptron import Perceptron
from fluidsnet.features.voxel import occupied_voxels
from fluidsnet.kernels import disabled
from fluidsnet.kernels.columns import apply_tanh
from fluidsnet.model import Model
from fluidsnet.neighbors import Auto, BruteForce, CellListCPU, NeighborSearch
from fluidsnet.network import Network
from fluidsnet.particles import Particles
from fluidsnet.rollout import rollout
from fluidsnet.scene import Scene
from fluidsnet.target import AccelerationTarget, VelocityTarget
from fluidsnet.walls import StopAtWalls

Make = Callable[..., Particles]

CLOSE = 1e-5


def _scene() -> Scene:
    return Scene.single(
        domain_lower=(0.0, 0.0, 0.0),
        domain_upper=(1.5, 1.0, 1.5),
        gravity=(0.0, -9.81, 0.0),
        particle_radius=0.05,
        support_radius=0.2,
        time_step=0.02,
    )


def _frames(*counts: tuple[int, int], spread: float = 1.0, shift: float = 0.0) -> Particles:
    """Random frames of fluid and solid particles, both with velocities."""
    random = torch.Generator().manual_seed(0)
    frames = []
    for fluid, solid in counts:
        position = spread * torch.rand(fluid, 3, generator=random) + shift
        velocity = torch.randn(fluid, 3, generator=random)
        walls = spread * torch.rand(solid, 3, generator=random) + shift
        frames.append(Particles.single(position, velocity, walls, _scene()))
    batch = Particles.collate(frames)
    batch.solid_velocity.normal_(generator=random)
    return batch


def _duplicates() -> Particles:
    batch = _frames((200, 50))
    batch.position[:80] = batch.position[0]
    batch.solid_position[:20] = batch.position[0]
    return batch


def _lattice() -> Particles:
    # Many are equally far, and more than k within the radius.
    axis = torch.arange(8) * 0.0625
    position = torch.cartesian_prod(axis, axis, axis)
    random = torch.Generator().manual_seed(0)
    return Particles.single(
        position, torch.randn(512, 3, generator=random), position + 0.03125, _scene()
    )


def _not_finite() -> Particles:
    batch = _frames((300, 60))
    batch.position[3, 0], batch.position[77], batch.solid_position[5, 2] = (
        torch.nan,
        -torch.inf,
        torch.nan,
    )
    return batch


def _far_apart() -> Particles:
    batch = _frames((300, 60))
    batch.position[7], batch.position[8] = 1e6, torch.tensor([-3e30, 3e30, 3e38])
    return batch


CASES: dict[str, Callable[[], Particles]] = {
    "frames": lambda: _frames((300, 100), (1, 0), (0, 20), (150, 60)),
    "dense": lambda: _frames((900, 300), spread=0.4),
    "crowded": lambda: _frames((1500, 700), spread=0.1),
    "no solids": lambda: _frames((400, 0)),
    "one": lambda: _frames((1, 0)),
    "one and solids": lambda: _frames((1, 40), spread=0.2),
    "none": lambda: _frames((0, 30)),
    "many": lambda: _frames((9000, 2000), spread=2.0),
    "outside": lambda: _frames((400, 100), shift=-7.0),
    "duplicates": _duplicates,
    "lattice": _lattice,
    "not finite": _not_finite,
    "far apart": _far_apart,
}


def _both(
    particles: Particles, search: NeighborSearch, hidden: int = 7, width: int = 9
) -> tuple[Tensor, Tensor]:
    """The feature without edges, and with them."""
    torch.manual_seed(0)
    inputs, local = ParticleState(), NeighborMean(hidden, width)
    inputs.velocity_deviation.fill_(0.7)
    for weight in local.parameters():
        # Large enough that a tanh bends.
        nn.init.normal_(weight, std=0.7)
    with torch.no_grad():
        found = fused_local(particles, search, local, inputs)
        assert found is not None
        return found, local(particles, search(particles), inputs, torch.empty(0))


@pytest.mark.parametrize("k", [1, 8, 32])
@pytest.mark.parametrize("case", CASES)
def test_no_edges_give_what_edges_give(case: str, k: int) -> None:
    particles = CASES[case]()
    found, expected = _both(particles, CellListCPU(k))
    assert found.isfinite().all()
    assert torch.allclose(found, expected, atol=CLOSE, rtol=0)


@pytest.mark.parametrize(("hidden", "width"), [(1, 1), (8, 3), (19, 24)])
def test_any_widths(hidden: int, width: int) -> None:
    found, expected = _both(_frames((300, 100)), Auto(32), hidden, width)
    assert torch.allclose(found, expected, atol=CLOSE, rtol=0)


def test_real_frames(sample: Path) -> None:
    reader = FrameReader(sample / "train.h5")
    search = Auto(32)
    for name, frames in reader.frames.items():
        for frame in (0, frames // 2, frames - 1):
            found, expected = _both(reader.state(name, frame, stride=1), search)
            assert torch.allclose(found, expected, atol=CLOSE, rtol=0)


def test_solids_that_move_are_not_kept() -> None:
    search, particles = CellListCPU(8), _frames((300, 100))
    for _ in range(2):
        found, expected = _both(particles, search)
        assert torch.allclose(found, expected, atol=CLOSE, rtol=0)
        particles.solid_position.mul_(0.9)
        particles.solid_velocity.add_(1.0)


def test_a_velocity_that_is_none_is_not_hidden() -> None:
    particles = _frames((300, 0))
    particles.velocity[4] = torch.nan
    found, expected = _both(particles, CellListCPU(32))
    assert torch.equal(found.isnan(), expected.isnan()) and expected.isnan().any()
    finite = ~expected.isnan()
    assert torch.allclose(found[finite], expected[finite], atol=CLOSE, rtol=0)


def test_where_there_is_no_such_way() -> None:
    particles, inputs = _frames((50, 0)), ParticleState()
    with torch.no_grad():
        assert fused_local(particles, BruteForce(), NeighborMean(), inputs) is None
        assert fused_local(particles, Auto(), KernelMessages(), inputs) is None
        with disabled():
            assert fused_local(particles, Auto(), NeighborMean(), inputs) is None
    assert fused_local(particles, Auto(), NeighborMean(), inputs) is None


@pytest.mark.parametrize("case", [case for case in CASES if case != "far apart"])
def test_the_network_is_the_same_with_and_without_gradients(case: str) -> None:
    torch.manual_seed(0)
    network = Network(
        (6, 4, 6), Auto(), ParticleState(), NeighborMean(), GlobalVector, VelocityTarget()
    ).eval()
    particles = CASES[case]()
    expected = output_of(network, particles)
    for context in (torch.no_grad, torch.inference_mode):
        with context():
            found = output_of(network, particles)
        assert torch.allclose(found, expected, atol=CLOSE, rtol=0, equal_nan=True)


def test_tanh() -> None:
    values = np.concatenate(
        [np.linspace(-12, 12, 1_000_001), [1e-30, -1e-7, 1e30, np.inf, -np.inf]]
    ).astype(np.float32)
    found = values.copy()
    apply_tanh(found)
    assert np.abs(found - np.tanh(values.astype(np.float64))).max() < 5e-7
    nothing = np.full(40, np.nan, np.float32)
    apply_tanh(nothing)
    assert np.isnan(nothing).all()


@pytest.mark.parametrize("widths", [(48, 32, 16, 8, 3), (5, 1), (3, 70, 9)])
@pytest.mark.parametrize("rows", [0, 1, 160, 5000])
@pytest.mark.parametrize("own", [1, 3])
@pytest.mark.parametrize("same", [False, True])
def test_a_perceptron_without_gradients(
    widths: tuple[int, ...], rows: int, own: int, same: bool
) -> None:
    torch.manual_seed(0)
    perceptron, values = Perceptron(widths), 3 * torch.randn(rows, own)
    values[rows // 2 :: 1000, 0] = torch.inf
    rest = widths[0] - own
    context = torch.randn(1, rest).expand(rows, -1) if same else torch.randn(rows, rest)
    expected = perceptron(values, context)
    assert torch.equal(expected, nn.Sequential(*perceptron)(torch.cat([values, context], dim=1)))
    with torch.no_grad():
        found = perceptron(values, context)
    assert torch.allclose(found, expected, atol=CLOSE, rtol=0, equal_nan=True)


def _voxels(layers: nn.ModuleList, features: Tensor, index: Tensor, cells: int) -> Tensor:
    """The voxel feature as the paper words it: each particle beside its cell's mean."""
    for layer in layers:
        own = torch.tanh(layer.norm(layer.linear(features)))
        shared = scatter(own, index, dim=0, dim_size=cells, reduce="mean")
        features = torch.cat([own, shared[index]], dim=1)
    return scatter(features, index, dim=0, dim_size=cells, reduce="mean")


@pytest.mark.parametrize("widths", [(32, 64, 128), (6,), (20, 10)])
@pytest.mark.parametrize("counts", [((700, 0),), ((5000, 0), (1, 0), (300, 0)), ((0, 0),)])
def test_the_voxel_feature_without_gradients(
    counts: tuple[tuple[int, int], ...], widths: tuple[int, ...]
) -> None:
    torch.manual_seed(0)
    particles = _frames(*counts)
    cells, voxel = occupied_voxels(particles, (6, 4, 5)), VoxelFeature(16, widths).eval()
    for layer in voxel.layers:
        nn.init.normal_(layer.norm.running_mean)
        nn.init.uniform_(layer.norm.running_var, 0.5, 2)
    features = torch.randn(len(particles), 16)
    expected = _voxels(voxel.layers, features, cells.index, len(cells.cell))
    assert torch.allclose(voxel(features, cells), expected, atol=CLOSE, rtol=0)
    with torch.no_grad():
        assert torch.allclose(voxel(features, cells), expected, atol=CLOSE, rtol=0)


def test_the_voxel_feature_has_the_gradients_of_the_plain_one(make_particles: Make) -> None:
    torch.manual_seed(0)
    particles = make_particles((400, 0), (100, 0))
    device = particles.position.device
    cells, voxel = occupied_voxels(particles, (4, 3, 4)), VoxelFeature(16).to(device).double()
    features = torch.randn(500, 16, device=device, dtype=torch.float64, requires_grad=True)
    weights = [features, *voxel.parameters()]
    plain = _voxels(voxel.layers, features, cells.index, len(cells.cell))
    toward = torch.randn_like(plain)
    expected = torch.autograd.grad(plain, weights, toward)
    found = torch.autograd.grad(voxel(features, cells), weights, toward)
    for one, other in zip(found, expected, strict=True):
        assert torch.allclose(one, other, atol=1e-9)


def test_a_rollout_holds_its_memory_constant() -> None:
    torch.manual_seed(0)
    model = Model((6, 4, 6), target=AccelerationTarget(), walls=StopAtWalls()).eval()
    states = rollout(model, _frames((3000, 1000)), 220)
    held = []
    for step, _ in enumerate(states):
        if step >= 20:
            held.append(_resident())
    # A step's own tensors have some 2 MB.
    assert max(held) - held[0] < 8e6


def _resident() -> int:
    """Bytes of this process that are in memory."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("only Linux tells what is in memory now")
    return int(statm.read_text().split()[1]) * 4096


def test_walls_that_need_a_gradient_get_one() -> None:
    batch, feature = _frames((60, 40)), NeighborMean().requires_grad_(False)
    batch.solid_position.requires_grad_()
    search, inputs = CellListCPU(), ParticleState()
    assert fused_local(batch, search, feature, inputs) is None
    found = feature(batch, search(batch), inputs, torch.empty(0))
    (gradient,) = torch.autograd.grad(found.sum(), batch.solid_position)
    assert gradient.abs().max() > 0
