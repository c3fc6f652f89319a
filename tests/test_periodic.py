"""Periodic axes, beside a slow reference that puts a copy of the box on every side."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from torch import Tensor

from datamodules.augmentation import BoxSymmetry
from datamodules.reader import FrameReader
from datamodules.schema import SceneAttributes
from fluidsnet.errors import UserError
from fluidsnet.features import GlobalVector, NoGlobalFeature, VoxelField
from fluidsnet.integrator import Displacement
from fluidsnet.kernels import disabled
from fluidsnet.metrics.positions import CenterOfMass, RolloutPositionError
from fluidsnet.model import Model
from fluidsnet.neighbors import Auto, BruteForce
from fluidsnet.particles import Particles, Transitions
from fluidsnet.periodic import shortest, with_images, wrapped
from fluidsnet.priors import PressureStep
from fluidsnet.scene import Scene
from fluidsnet.statistics import Statistics
from fluidsnet.target import DisplacementTarget

EDGES = (1.0, 0.8, 1.2)
AXES = [(True, False, False), (True, True, True), (False, True, True)]


def state(
    periodic: tuple[bool, bool, bool], fluid: int = 60, support: float = 0.3, seed: int = 0
) -> Particles:
    """Return random fluid and solids in a box, some of them next to its faces."""
    random = torch.Generator().manual_seed(seed)
    scene = Scene.single(
        (0.5, -0.2, 0.0), (1.5, 0.6, 1.2), (0.0, -9.81, 0.0), support / 4, support, 0.02,
        periodic=periodic,
    )  # fmt: skip
    place = lambda count: torch.rand(count, 3, generator=random) * scene.extent + scene.domain_lower  # noqa: E731
    particles = Particles.single(
        place(fluid), torch.randn(fluid, 3, generator=random), place(20), scene
    )
    return replace(particles, solid_velocity=torch.randn(20, 3, generator=random))


def repeated(particles: Particles) -> list[tuple[Tensor, int, Tensor]]:
    """Return the shift and row of each copy of each particle, and its place."""
    both = torch.cat([particles.position, particles.solid_position])
    steps = [(-2, -1, 0, 1, 2) if on else (0,) for on in particles.scene.periodic]
    shifts = [torch.tensor(it) * particles.scene.extent[0] for it in product(*steps)]
    return [(shift, row, both[row] + shift) for shift in shifts for row in range(len(both))]


@pytest.mark.parametrize("support", [0.3, 1.1])
@pytest.mark.parametrize("periodic", AXES)
def test_neighbors_are_those_among_copies_of_the_box(
    periodic: tuple[bool, bool, bool], support: float
) -> None:
    particles = state(periodic, fluid=15, support=support)
    imaged = with_images(particles)
    found = BruteForce(2000)(imaged)
    both = torch.cat([imaged.position, imaged.solid_position])
    velocity = torch.cat([imaged.velocity, imaged.solid_velocity])
    sent = torch.cat([particles.velocity, particles.solid_velocity])
    marker = torch.cat([torch.ones(15), torch.zeros(len(imaged.solid_position))]).bool()
    assert imaged.fluid_image is not None
    marker[15:] = imaged.fluid_image
    for particle in range(15):
        own = found.neighbor[found.particle == particle]
        edges = torch.cat([both[own] - both[particle], velocity[own], marker[own, None]], dim=1)
        rows = [
            torch.cat([place - both[particle], sent[row], torch.tensor([float(row < 15)])])
            for shift, row, place in repeated(particles)
            if (place - both[particle]).norm() <= support
            and not (row == particle and bool((shift == 0).all()))
        ]
        expected = torch.stack(rows) if rows else edges[:0]
        assert len(edges) == len(expected)
        # In one order.
        keys = [(100 * it[:, :3]).round().long().tolist() for it in (edges, expected)]
        order = [sorted(range(len(key)), key=key.__getitem__) for key in keys]
        torch.testing.assert_close(edges[order[0]], expected[order[1]], atol=1e-5, rtol=0)


def model() -> Model:
    """Return a network with random weights, without a grid that would tell places apart."""
    torch.manual_seed(0)
    built = Model(
        (4, 3, 5), Auto(64), global_feature=NoGlobalFeature, target=DisplacementTarget(),
        integrator=Displacement(),
    )  # fmt: skip
    scale = torch.tensor
    built.set_statistics(
        Statistics(
            torch.zeros(3), scale(1.0), torch.zeros(3), scale(0.1), scale(0.05),
            torch.zeros(5), torch.zeros(5),
        ),
        0.02,
    )  # fmt: skip
    return built.eval()


@pytest.mark.parametrize("periodic", AXES)
def test_a_state_and_its_wrapped_one_step_alike_by_kernels_and_torch(
    periodic: tuple[bool, bool, bool],
) -> None:
    particles, network = state(periodic), model()
    expected = network.step(particles)
    away = torch.tensor([[3.0, -2.0, 1.0]]) * particles.scene.extent * torch.tensor(periodic)
    found = network.step(replace(particles, position=particles.position + away))
    torch.testing.assert_close(
        shortest(found.position - expected.position, expected),
        torch.zeros_like(found.position), atol=1e-5, rtol=0,
    )  # fmt: skip
    torch.testing.assert_close(found.velocity, expected.velocity, atol=1e-4, rtol=1e-4)
    inside = wrapped(expected).position
    assert torch.equal(inside, expected.position)
    with disabled():
        torch.testing.assert_close(
            network.step(particles).velocity, expected.velocity, atol=1e-5, rtol=1e-5
        )


def test_a_batch_steps_as_its_frames_alone() -> None:
    frames, network = [state(AXES[1], fluid, seed=fluid) for fluid in (30, 50)], model()
    batch = network.step(Particles.collate(frames))
    alone = torch.cat([network.step(it).velocity for it in frames])
    torch.testing.assert_close(batch.velocity, alone, atol=1e-5, rtol=1e-5)


def test_without_periodic_axes_nothing_is_made() -> None:
    particles = state((False, False, False))
    assert with_images(particles) is particles and wrapped(particles) is particles


def test_gradients_cross_the_faces() -> None:
    particles = state(AXES[1], fluid=8)
    position = particles.position.double().requires_grad_()
    scene = replace(
        particles.scene, **{
            name: getattr(particles.scene, name).double()
            for name in ("domain_lower", "domain_upper")
        },
    )  # fmt: skip
    weight = torch.randn(8, 3, generator=torch.Generator().manual_seed(1)).double()

    def energy(place: Tensor) -> Tensor:
        imaged = with_images(
            replace(
                particles, position=place, solid_position=particles.solid_position.double(),
                velocity=weight, solid_velocity=particles.solid_velocity.double(), scene=scene,
            )
        )  # fmt: skip
        both = torch.cat([imaged.position, imaged.solid_position])
        offsets = imaged.position[:, None] - both[None]
        return (offsets.square().sum(dim=2) + 0.1).reciprocal().sum()

    assert torch.autograd.gradcheck(energy, position)


def test_errors_take_the_shortest_way() -> None:
    true = state(AXES[1])
    moved = wrapped(true.moved(true.position + 0.01, true.velocity))
    metric = RolloutPositionError([0], 1)
    metric.update(0, 1, moved, true, true)
    expected = 10 * 3**0.5
    assert float(metric.compute()["position_error_mm"]) == pytest.approx(expected, rel=1e-4)
    # A center of mass has no place where axes repeat.
    center = CenterOfMass([0], 1)
    center.update(0, 1, moved, true, true)
    assert center.compute()["center_of_mass"].isnan().all()


@pytest.mark.parametrize("block", ["prior", "global_feature"])
def test_blocks_that_do_not_know_them_are_refused(block: str) -> None:
    blocks: dict[str, Callable[..., object]] = {
        "prior": PressureStep, "global_feature": lambda: VoxelField
    }  # fmt: skip
    built = Model((4, 3, 5), target=DisplacementTarget(), **{block: blocks[block]()})  # type: ignore[arg-type]
    with pytest.raises(UserError, match=r"has periodic axes, which \w+ does not know; use the"):
        built.check_scenes(state(AXES[0]).scene)
    Model((4, 3, 5), global_feature=GlobalVector).check_scenes(state(AXES[0]).scene)


@pytest.mark.parametrize("periodic", [(True, False, False), (True, False, True)])
def test_mirrored_samples_cross_the_faces_as_they_did(periodic: tuple[bool, bool, bool]) -> None:
    scene = Scene.single(
        (0, 0, 0), (1, 1, 1), (0, -9.81, 0), 0.025, 0.1, 0.02, periodic=periodic
    )  # fmt: skip
    start = Particles.single(
        torch.tensor([[0.99, 0.5, 0.3]]), torch.tensor([[1.0, 0, 0]]), torch.zeros(0, 3), scene
    )
    after = torch.tensor([[[0.01, 0.5, 0.3]]])
    sample = Transitions(start, after, start.velocity[None], torch.zeros(1, dtype=torch.int64))
    torch.manual_seed(0)
    for _ in range(30):
        found = BoxSymmetry()(sample)
        step = shortest(found.next_position[0] - found.state.position, found.state)
        assert step.norm() == pytest.approx(0.02, rel=1e-4)


@pytest.mark.parametrize(
    ("change", "expected"),
    [({"solid": 1.2}, "1 solids of /00000 are outside the domain along a"), ({"solid": 0.5}, "")],
)
def test_solids_across_a_face_are_refused(
    change: dict[str, float], expected: str, sample: Path, tmp_path: Path
) -> None:
    path = tmp_path / "val.h5"
    shutil.copy(sample / "val.h5", path)
    with h5py.File(path, "r+") as file:
        width = np.asarray(SceneAttributes.read(file["00000"]).domain_upper)
        for group in file.values():
            group.attrs["periodic"] = [True, True, True]
        solids = np.tile(0.5 * width, (3, 1))
        solids[0, 0] = change["solid"] * width[0]
        del file["00000/solid_position"]
        file["00000/solid_position"] = solids.astype(np.float32)
    reader = FrameReader(path)
    if expected:
        with pytest.raises(UserError, match=expected):
            reader.state("00000", 0, 1)
    else:
        assert len(reader.state("00000", 0, 1).solid_position) == 3


def test_a_plane_is_not_periodic_across_itself(sample: Path, tmp_path: Path) -> None:
    path = tmp_path / "val.h5"
    shutil.copy(sample / "val.h5", path)
    with h5py.File(path, "r+") as file:
        for group in file.values():
            group.attrs["periodic"], group.attrs["dimension"] = [True, True, True], 2
    assert FrameReader(path).scenes(1)[0].periodic == (True, True, False)
